"""Text vectors out of a recording: labels it knows, names it does not, other names of the same."""

from __future__ import annotations

import numpy as np

from dssmsg.interfaces import Encoder
from dssmsg.review.recorded_vectors import RecordedVectors

CHAIR, SINK = (row.astype(np.float32) for row in np.eye(8)[:2])


class Stub:
    """As much of a recording as is asked for."""

    facts = {"feature_space": "toy/8"}  # noqa: RUF012

    def __init__(self, **vectors: np.ndarray) -> None:
        self._vectors = vectors

    def label_vectors(self) -> dict[str, np.ndarray]:
        return self._vectors


def vectors() -> RecordedVectors:
    return RecordedVectors(Stub(Chair=CHAIR, sink=SINK), {"washbasin": "sink"})  # type: ignore[arg-type]


def test_labels_have_the_vectors_they_were_recorded_with() -> None:
    encoder = vectors()
    assert isinstance(encoder, Encoder)
    assert (encoder.space, encoder.dimension, encoder.labels) == ("toy/8", 8, 2)
    assert np.array_equal(encoder.encode_labels(["chair", "sink"]), [CHAIR, SINK])
    assert np.array_equal(encoder.encode_labels(["washbasin"]), [SINK])
    assert encoder.encode_labels([]).shape == (0, 8)


def test_an_unknown_name_is_itself_and_nothing_else() -> None:
    first, again, other = vectors().encode_labels(["gnu", "gnu", "yak"])
    assert np.array_equal(first, again)
    assert abs(float(first @ other)) < 0.9
    assert np.isclose(np.linalg.norm(first), 1.0)


def test_a_text_is_what_it_mentions() -> None:
    (both,) = vectors().encode_text(["a chair by the sink"])
    assert np.allclose(both, (CHAIR + SINK) / np.sqrt(2))


def test_without_recorded_vectors_names_agree_or_differ() -> None:
    encoder = RecordedVectors(Stub(), {"washbasin": "sink"})  # type: ignore[arg-type]
    rows = encoder.encode_labels(["sink", "washbasin", "chair"])
    assert rows.shape == (3, 384)
    assert np.allclose(rows[0], rows[1])
    assert abs(float(rows[0] @ rows[2])) < 0.3
