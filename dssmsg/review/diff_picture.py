"""A difference of two runs as one recording for the viewer: both graphs, and marks on what differs."""

from __future__ import annotations

from pathlib import Path

from dssmsg.recording.comparison import ONE_SIDED, OTHERWISE, write_comparison
from dssmsg.recording.palette import Colour
from dssmsg.recording.reader import Recording
from dssmsg.review.diff import Difference
from dssmsg.review.diff_text import difference_text

Mark = tuple[str, str, Colour]


def write_picture(path: Path, a: Recording, b: Recording, difference: Difference) -> None:
    """Write the recording. Raises StorageError where the file exists or cannot be written."""
    parted = difference.divergence
    write_comparison(
        path,
        (a, b),
        summary=f"```\n{difference_text(difference)}\n```\n",
        marks=_marks(difference),
        apart_from=None if parted is None else parted.frame,
    )


def _marks(difference: Difference) -> dict[str, list[Mark]]:
    objects = difference.objects
    marks: dict[str, list[Mark]] = {
        "a": [(one.id, f"{one.label}: only in A", ONE_SIDED) for one in objects.only_a],
        "b": [(one.id, f"{one.label}: only in B", ONE_SIDED) for one in objects.only_b],
    }
    for pair in objects.differing:
        for side, own, other in (("a", pair.a, pair.b), ("b", pair.b, pair.a)):
            words = ", ".join(f"{getattr(own, name)}, not {getattr(other, name)}" for name in pair.differs)
            marks[side].append((own.id, f"{own.label}: {words}", OTHERWISE))
    return marks
