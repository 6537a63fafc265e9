"""The encoder as everybody gets it: what it returns is checked once, here, and blamed on it."""

from __future__ import annotations

from collections.abc import Sequence

from dssmsg import checks
from dssmsg.errors import DssmsgError, PluginError
from dssmsg.frame import ByteArray, Float32Array
from dssmsg.interfaces import Encoder


class CheckedEncoder:
    """Forwards to an `encoder` plug-in; PluginError naming it where vectors are missing or not unit."""

    def __init__(self, encoder: Encoder, plugin: str) -> None:
        self._encoder = encoder
        self._plugin = plugin
        self.space = encoder.space
        self.dimension = encoder.dimension

    def encode_labels(self, labels: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of object labels."""
        return self._checked(self._encoder.encode_labels(labels), len(labels))

    def encode_text(self, texts: Sequence[str]) -> Float32Array:
        """(N, D) unit vectors of free text."""
        return self._checked(self._encoder.encode_text(texts), len(texts))

    def encode_crops(self, crops: Sequence[ByteArray]) -> Float32Array | None:
        """(N, D) unit vectors of RGB crops, or None."""
        vectors = self._encoder.encode_crops(crops)
        return None if vectors is None else self._checked(vectors, len(crops))

    def _checked(self, vectors: Float32Array, count: int) -> Float32Array:
        try:
            return checks.check_vectors(vectors, count, self.dimension)
        except DssmsgError:
            raise
        except Exception as error:
            raise PluginError(str(error), plugin=self._plugin) from error
