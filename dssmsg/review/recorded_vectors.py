"""Text vectors out of a recording, for machines on which the encoder's model cannot run."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from dssmsg.frame import ByteArray, Float32Array
from dssmsg.lexicon.aliases import plain_name
from dssmsg.recording.reader import Recording

_DIMENSION_WITHOUT = 384
"""Of the vectors where nothing was recorded: names then only agree or differ."""


class RecordedVectors:
    """An encoder that knows the labels of a run by the vectors that were recorded with them.

    A name that was never detected, not under another name of `aliases` either, gets a vector of its own that
    is near no other: it matches itself and nothing else.
    """

    def __init__(self, recording: Recording, aliases: Mapping[str, str]) -> None:
        self._aliases = aliases
        found = {plain_name(label): vector for label, vector in recording.label_vectors().items()}
        self.dimension = next((len(vector) for vector in found.values()), _DIMENSION_WITHOUT)
        self.space: str = recording.facts["feature_space"] or f"names/{self.dimension}"
        usable = {name: vector for name, vector in found.items() if vector.shape == (self.dimension,)}
        self._vectors = {self._canonical(name): vector for name, vector in usable.items()} | usable

    @property
    def labels(self) -> int:
        """How many labels have a recorded vector."""
        return len(self._vectors)

    def encode_labels(self, labels: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of object labels."""
        rows = [self._vector(label) for label in labels]
        return np.stack(rows) if rows else np.zeros((0, self.dimension), np.float32)

    def encode_text(self, texts: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of free text: the mean of the labels that it mentions, else one of its own."""
        return self.encode_labels(texts) if not texts else np.stack([self._of_text(text) for text in texts])

    def encode_crops(self, crops: Sequence[ByteArray]) -> Float32Array | None:
        """None: nothing is seen here."""
        return None

    def _of_text(self, text: str) -> Float32Array:
        words = f" {plain_name(text)} "
        named = [vector for name, vector in self._vectors.items() if f" {name} " in words]
        return _unit(np.sum(named, axis=0)) if named else self._vector(text)

    def _vector(self, label: str) -> Float32Array:
        name = plain_name(label)
        for known in (name, self._canonical(name)):
            if known in self._vectors:
                return self._vectors[known]
        seed = hashlib.sha256(self._canonical(name).encode()).digest()[:8]
        return _unit(np.random.default_rng(int.from_bytes(seed, "little")).normal(size=self.dimension))

    def _canonical(self, name: str) -> str:
        return self._aliases.get(name, name)


def _unit(vector: np.ndarray) -> Float32Array:
    length = float(np.sqrt(np.sum(np.square(vector, dtype=np.float64))))
    unit: Float32Array = (vector / max(length, 1e-12)).astype(np.float32)
    return unit
