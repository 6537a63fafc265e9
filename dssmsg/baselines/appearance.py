"""How alike two things look and what they are called: raw cosines, as both methods use them."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dssmsg.frame import Float32Array


class Described(Protocol):
    """What observations and objects have in common: a label and unit features (D,), where perception gives
    them."""

    @property
    def label(self) -> str:
        """What it is called."""
        ...

    @property
    def text_feature(self) -> Float32Array | None:
        """The label's vector in the text space."""
        ...

    @property
    def image_feature(self) -> Float32Array | None:
        """The crop's vector in the image space."""
        ...


def text_cosine(a: Described, b: Described) -> float:
    """Cosine -1..1 of the text features; where one has none, 1 for the same label and 0 otherwise."""
    if a.text_feature is None or b.text_feature is None:
        return 1.0 if a.label == b.label else 0.0
    return _cosine(a.text_feature, b.text_feature)


def image_cosine(a: Described, b: Described) -> float:
    """Cosine -1..1 of the image features; where perception gives none, the text stands in for them."""
    if a.image_feature is None or b.image_feature is None:
        return text_cosine(a, b)
    return _cosine(a.image_feature, b.image_feature)


def _cosine(a: Float32Array, b: Float32Array) -> float:
    # np.sum adds in a fixed order; the order of BLAS depends on threads and processor.
    return float(np.clip(np.sum(a.astype(np.float64) * b.astype(np.float64)), -1.0, 1.0))
