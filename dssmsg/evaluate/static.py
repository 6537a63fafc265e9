"""Static objects of the map against the truth that was visible (paper, Table I left; ALGORITHM, Scores)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from dssmsg.evaluate.visible import Place
from dssmsg.geometry import box_iou
from dssmsg.graph.nodes import BELIEVED, ObjectNode

MIN_FRAMES = 3
MIN_IOU = 0.25
MAX_CENTRE_M = 0.3


@dataclass(frozen=True, slots=True)
class StaticScore:
    """Precision, recall and F1 with their counts; `centre_errors_m` of the matched ones.

    `missed` and `wrong` name the truth and the objects behind the false negatives and positives.
    """

    true_positives: int
    false_positives: int
    false_negatives: int
    ignored: int
    centre_errors_m: tuple[float, ...]
    missed: tuple[str, ...]
    wrong: tuple[str, ...]

    @property
    def precision(self) -> float:
        """Share of the counted objects that are true; 1 if none was counted."""
        counted = self.true_positives + self.false_positives
        return self.true_positives / counted if counted else 1.0

    @property
    def recall(self) -> float:
        """Share of the visible truth that was found; 1 if nothing was visible."""
        visible = self.true_positives + self.false_negatives
        return self.true_positives / visible if visible else 1.0

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        total = self.precision + self.recall
        return 2 * self.precision * self.recall / total if total else 0.0

    @property
    def median_centre_error_m(self) -> float:
        """Median distance from the centre of the visible surface; NaN if nothing matched."""
        return float(np.median(self.centre_errors_m)) if self.centre_errors_m else float("nan")


def score_static(
    objects: Iterable[ObjectNode], places: Sequence[Place], *, min_frames: int = MIN_FRAMES
) -> StaticScore:
    """Match believed objects to the true static objects one-to-one, by label and place.

    A match needs the label and 3D IoU >= 0.25 with the visible surface or with the whole true box, or the
    centres within min(0.3 m, half the diagonal). Objects that match only truth below the visibility bar,
    or a place of a dynamic object, are ignored: neither right nor wrong.
    """
    predicted = [node for node in objects if node.status == BELIEVED]
    wanted = [p for p in places if p.state == "static" and p.frames >= min_frames]
    other = [p for p in places if not (p.state == "static" and p.frames >= min_frames)]
    cost = np.full((len(predicted), len(wanted)), 10.0)
    for i, node in enumerate(predicted):
        for j, place in enumerate(wanted):
            if matches(node, place):
                cost[i, j] = _centre_error(node, place) - 5.0
    rows, columns = linear_sum_assignment(cost)
    pairs = [(i, j) for i, j in zip(rows, columns, strict=True) if cost[i, j] < 5.0]
    taken = {i for i, _ in pairs}
    found = {j for _, j in pairs}
    rest = [node for i, node in enumerate(predicted) if i not in taken]
    wrong = [node for node in rest if not any(matches(node, place) for place in other)]
    return StaticScore(
        true_positives=len(pairs),
        false_positives=len(wrong),
        false_negatives=len(wanted) - len(found),
        ignored=len(rest) - len(wrong),
        centre_errors_m=tuple(_centre_error(predicted[i], wanted[j]) for i, j in pairs),
        missed=tuple(place.name for j, place in enumerate(wanted) if j not in found),
        wrong=tuple(f"{node.id} ({node.label})" for node in wrong),
    )


def matches(node: ObjectNode, place: Place) -> bool:
    """Whether an object may stand for a true place: same label, and near enough."""
    if node.label != place.label:
        return False
    boxes = [(place.box_min, place.box_max)]
    if place.surface_min is not None and place.surface_max is not None:
        boxes.append((place.surface_min, place.surface_max))
    if any(float(box_iou(node.box_min, node.box_max, low, high)) >= MIN_IOU for low, high in boxes):
        return True
    reach = min(MAX_CENTRE_M, float(np.linalg.norm(place.box_max - place.box_min)) / 2)
    return _centre_error(node, place) <= reach


def _centre_error(node: ObjectNode, place: Place) -> float:
    """Distance of the object's centre from that of the visible surface (of the true box if nothing was)."""
    low, high = (
        (place.box_min, place.box_max)
        if place.surface_min is None or place.surface_max is None
        else (place.surface_min, place.surface_max)
    )
    return float(np.linalg.norm(node.center - (low + high) / 2))
