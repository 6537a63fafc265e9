"""What a frame says of an object: the verdicts, and the evidence that carries one (ALGORITHM B)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

SEEN, MISSED, PRESENT, OCCLUDED = "seen", "missed", "present", "occluded"
OUT_OF_RANGE, OUT_OF_VIEW, UNKNOWN = "out_of_range", "out_of_view", "unknown"
"""`missed`: its place is in view and shown free. `present`: depth shows a surface where it stood, though no
detection says so. `unknown`: no reading, or too little of it to tell."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """What one frame says of one object, with the numbers behind it (shares of its points, colours)."""

    frame: int
    object_id: str
    verdict: str
    values: Mapping[str, float] = field(default_factory=dict)
