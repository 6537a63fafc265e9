"""encoder: text -> unit vector, and crop -> unit vector where it can; declares its space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from dssmsg.frame import ByteArray, Float32Array


@runtime_checkable
class Encoder(Protocol):
    """Text (and crops) into one space of unit vectors."""

    space: str
    """Name of the space, e.g. `all-minilm-l6-v2/384`; features of two plug-ins compare only in one space."""
    dimension: int

    def encode_labels(self, labels: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of object labels (prompt template and aliases applied); cached."""
        ...

    def encode_text(self, texts: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of free text, taken as it is."""
        ...

    def encode_crops(self, crops: Sequence[ByteArray]) -> Float32Array | None:
        """(N, D) unit vectors of RGB crops (H, W, 3), or None if this encoder cannot see."""
        ...
