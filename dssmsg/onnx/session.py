"""The one place that opens onnxruntime sessions: threads, hashes, number types, errors that name the file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dssmsg.errors import ConfigError, InputError

Threads = Annotated[int, Field(ge=1, le=64)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-fA-F]{64}$")]
FilePath = Annotated[str, Field(min_length=1, max_length=4096)]

_NUMPY_TYPES: Mapping[str, type[np.generic]] = {
    "float": np.float32,
    "float16": np.float16,
    "double": np.float64,
    "int64": np.int64,
    "int32": np.int32,
    "uint8": np.uint8,
    "int8": np.int8,
    "bool": np.bool_,
}


@dataclass(frozen=True, slots=True)
class Port:
    """An input or output of a graph. `dtype` as ONNX spells it (float, float16, int64, ...).

    `shape` has a number where the graph fixes a size, a name or None where it does not.
    """

    name: str
    dtype: str
    shape: tuple[int | str | None, ...]

    def __str__(self) -> str:
        sizes = ", ".join("?" if size is None else str(size) for size in self.shape)
        return f"{self.name} ({sizes}) {self.dtype}"

    @property
    def is_float(self) -> bool:
        """Whether it takes or gives floating point numbers of a kind that numpy knows."""
        return self.dtype in ("float", "float16", "double")

    def size(self, axis: int) -> int | None:
        """The size of an axis where the graph fixes it, else None."""
        size = self.shape[axis]
        return size if isinstance(size, int) else None


class OnnxModel:
    """An opened model file: what it takes and gives, what its exporter noted, and `run`."""

    def __init__(self, path: Path, sha256: str, session: Any) -> None:
        self.path = path
        self.sha256 = sha256
        """Of the model file itself; weights kept in a second file beside it are not covered."""
        self._session = session
        self.inputs = tuple(_port(one) for one in session.get_inputs())
        self.outputs = tuple(_port(one) for one in session.get_outputs())
        self.metadata: Mapping[str, str] = MappingProxyType(
            dict(session.get_modelmeta().custom_metadata_map or {})
        )
        self._dtypes = {port.name: _NUMPY_TYPES.get(port.dtype) for port in self.inputs}

    def run(self, feeds: Mapping[str, NDArray[Any]], outputs: Sequence[str]) -> list[NDArray[Any]]:
        """The named outputs, in that order; numbers in are cast to what the graph takes.

        Half and double precision come back as float32. Raises ValueError for NaN or infinity in an output and
        RuntimeError, with the runtime's reason, where the graph cannot be run on these inputs.
        """
        cast = {
            name: np.ascontiguousarray(value, dtype=self._dtypes[name] or value.dtype)
            for name, value in feeds.items()
        }
        try:
            results = self._session.run(list(outputs), cast)
        except Exception as error:
            raise RuntimeError(f"{self.path.name} failed: {_one_line(error)}") from error
        values = [np.asarray(one) for one in results]
        for place, value in enumerate(values):
            if value.dtype.kind == "f":
                values[place] = value.astype(np.float32, copy=False)
                if not np.isfinite(values[place]).all():
                    raise ValueError(f"{self.path.name}: output {outputs[place]} holds NaN or infinity")
        return values

    def describe(self) -> str:
        """Inputs and outputs in one line."""
        return f"takes {', '.join(map(str, self.inputs))}; gives {', '.join(map(str, self.outputs))}"


def open_model(
    path: str | Path,
    *,
    base_dir: Path = Path(),
    threads: int = 1,
    sha256: str | None = None,
    key: str | None = None,
) -> OnnxModel:
    """Open a model file for the CPU; a relative path starts from `base_dir`.

    `key` is the option that names the file, for errors. Raises InputError if the file is missing or no ONNX
    model, ConfigError if it is not the one that `sha256` pins.
    """
    file = find_file(path, base_dir, key=key)
    found = file_sha256(file)
    check_sha256(file, found, sha256, key=key)
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # A spinning pool burns the core that the rest of the run needs.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise InputError(
            f"expected an ONNX model that onnxruntime {onnxruntime.__version__} can load: {_one_line(error)}",
            file=file,
            key=key,
        ) from error
    return OnnxModel(file, found, session)


def find_file(path: str | Path, base_dir: Path, *, key: str | None = None) -> Path:
    """The absolute path of a file of a user's; `~` is expanded. Raises InputError if there is none."""
    file = (base_dir / Path(path).expanduser()).absolute()
    if file.is_file():
        return file
    if file.is_dir():
        raise InputError("is a folder; expected a file", file=file, key=key)
    raise InputError("no such file", file=file, key=key)


def file_sha256(file: Path) -> str:
    """SHA-256 of a file's content, read in pieces: models reach gigabytes."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def check_sha256(file: Path, found: str, expected: str | None, *, key: str | None = None) -> None:
    """Raise ConfigError where a file is not the pinned one."""
    if expected is not None and found != expected.lower():
        raise ConfigError(
            f"expected the file with SHA-256 {expected.lower()[:12]}..., this one has {found[:12]}...; "
            "put the right file there or correct the sum",
            file=file,
            key=key,
        )


def _port(value: Any) -> Port:
    dtype = str(value.type).removeprefix("tensor(").removesuffix(")")
    shape = tuple(size if isinstance(size, int) and size >= 0 else (size or None) for size in value.shape)
    return Port(str(value.name), dtype, shape)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
