"""Converted models on disk, below the user's cache folder: all or nothing, and never one that was changed."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path
from typing import Literal

from dssmsg.errors import InputError, StorageError
from dssmsg.models.catalogue import CatalogueModel

State = Literal["ready", "missing", "changed"]


def models_folder() -> Path:
    """`dssmsg/models` below $XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dssmsg" / "models"


def cached_path(model: CatalogueModel) -> Path:
    """Where the model is, or would be; the name changes with its content."""
    return models_folder() / f"{model.name}-{model.sha256[:12]}.onnx"


def state(model: CatalogueModel) -> State:
    """Whether the model is there and what it shall be; reads all of it."""
    path = cached_path(model)
    if not path.is_file():
        return "missing"
    return "ready" if sha256_of(path) == model.sha256 else "changed"


def checked_path(model: CatalogueModel, path: Path | None = None, *, key: str | None = None) -> Path:
    """The file of the model: `path`, else the cached one, after its SHA-256 was checked.

    `key` is the option that names the file, for errors. Raises InputError where there is none or it is
    another one; says how to get it.
    """
    file = cached_path(model) if path is None else path
    if not file.is_file():
        place = "is not in the cache" if path is None else "is not there"
        raise InputError(
            f"the model {model.name} {place}; get it once with: {_command(model)}", file=file, key=key
        )
    found = sha256_of(file)
    if found != model.sha256:
        raise InputError(
            f"is not the model {model.name}: expected SHA-256 {model.sha256[:12]}..., got {found[:12]}...; "
            f"get it again with: {_command(model)}",
            file=file,
            key=key,
        )
    return file


def store(model: CatalogueModel, content: bytes) -> Path:
    """Keep `content` as the model: written beside its place first, so that readers see all or nothing.

    Raises StorageError where it cannot be written.
    """
    path = cached_path(model)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be written ({error.strerror})", file=path) from error
    return path


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal.

    Raises InputError where it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path) from error


def _command(model: CatalogueModel) -> str:
    return f"dssmsg models get {model.name}"
