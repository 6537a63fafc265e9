"""How well the furniture recogniser sees: known models in unseen rooms, and models it never saw.

Counted are the things that ALGORITHM.md calls visible: at least 200 pixels with a reading nearer than 4 m.
Rooms come from seeds that training never uses (`dssmsg/data/weights/models.yaml`), half of them arranged at
random, half generated homes; no packaged scene is among either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any

import numpy as np

from dssmsg.evaluate.visible import MAX_RANGE_M, MIN_PIXELS
from dssmsg.frame import Float32Array, MaskArray
from dssmsg.recogniser.recogniser import Recogniser, Seen
from dssmsg.recogniser.shelf import Shelf, seed_range
from dssmsg.recogniser.views import View, home_views, room_views
from dssmsg.sim.furniture import FurnitureLibrary

MIN_IOU = 0.5
TABLE = "perception"


@dataclass(slots=True)
class Tally:
    """Counts of one set of views. Votes are summed label probabilities by (seed, instance)."""

    views: int = 0
    rooms: int = 0
    true_masks: int = 0
    found_masks: int = 0
    predicted: int = 0
    predicted_right: int = 0
    labels: int = 0
    labels_right: int = 0
    found_labels_right: int = 0
    seconds: list[float] = field(default_factory=list)
    votes: dict[tuple[int, int], Float32Array] = field(default_factory=dict)
    sightings: dict[tuple[int, int], int] = field(default_factory=dict)
    truth: dict[tuple[int, int], str] = field(default_factory=dict)
    confusions: dict[tuple[str, str], int] = field(default_factory=dict)


def evaluate_perception(
    recogniser: Recogniser,
    *,
    rooms: int = 20,
    views: int = 16,
    assets: str = "real",
    min_views: int = 2,
    progress: Callable[[str], None] = lambda _line: None,
) -> list[dict[str, Any]]:
    """Rows of figures: `table`, `scene`, `method`, `perception`, `metric`, `mean`, `std`, `n`.

    `rooms` seeds of `views` views each for known models and, with real furniture, as many rooms of held-out
    models. Objects are judged by their votes over all views where there are at least `min_views`.
    """
    known = Tally()
    for seed, batch in _known_rooms(rooms, views, assets):
        _add(known, recogniser, seed, batch, only=None)
        progress(f"known models: {known.rooms} of {rooms} rooms, {known.views} views")
    rows = _rows("known models", known, recogniser, min_views)
    if assets == "real":
        shelf = Shelf(assets)
        held_out = frozenset(model.model for model in shelf.models if model.held_out)
        unseen = Tally()
        for seed in list(seed_range("unseen_models"))[:rooms]:
            _add(unseen, recogniser, seed, list(room_views(shelf, seed, views, held_out=True)), only=held_out)
            progress(f"unseen models: {unseen.rooms} of {rooms} rooms, {unseen.views} views")
        rows += _rows("unseen models", unseen, recogniser, min_views)
    return rows


def _known_rooms(rooms: int, views: int, assets: str) -> Iterator[tuple[int, list[View]]]:
    """(seed, views): arranged rooms of even seeds, generated homes of odd ones."""
    shelf, library = Shelf(assets), FurnitureLibrary.open(assets)
    for seed in list(seed_range("evaluation"))[:rooms]:
        yield seed, list(home_views(library, seed, views) if seed % 2 else room_views(shelf, seed, views))


def _add(
    tally: Tally, recogniser: Recogniser, seed: int, views: Sequence[View], only: frozenset[str] | None
) -> None:
    """Look at the views of one room; with `only`, labels of these models alone are counted."""
    tally.rooms += 1
    for view in views:
        tally.views += 1
        start = process_time()
        seen = recogniser.see(view.frame)
        tally.seconds.append(process_time() - start)
        counted = visible(view)
        _add_masks(tally, view, seen, counted, recogniser.labels)
        wanted = [number for number in counted if only is None or view.things[number][1] in only]
        if not wanted:
            continue
        _, logits, context = recogniser.opinions(view.frame, [view.instance_ids == n for n in wanted])
        probabilities = recogniser.joint(logits, context)
        for number, row in zip(wanted, probabilities, strict=True):
            label = view.things[number][0]
            said = recogniser.labels[int(np.argmax(row[:-1]))]
            tally.labels += 1
            tally.labels_right += said == label
            if said != label:
                tally.confusions[label, said] = tally.confusions.get((label, said), 0) + 1
            key = (seed, number)
            tally.truth[key] = label
            tally.votes[key] = tally.votes.get(key, np.zeros(len(row) - 1, np.float32)) + row[:-1]
            tally.sightings[key] = tally.sightings.get(key, 0) + 1


def visible(view: View) -> list[int]:
    """Instance ids that count: enough pixels with a near reading."""
    near = (view.frame.depth > 0) & (view.frame.depth < MAX_RANGE_M)
    pixels = np.bincount(view.instance_ids[near].ravel())
    return [int(number) for number in np.flatnonzero(pixels >= MIN_PIXELS) if number]


def _add_masks(
    tally: Tally, view: View, seen: Sequence[Seen], counted: Sequence[int], labels: Sequence[str]
) -> None:
    tally.true_masks += len(counted)
    kept = [one for one in seen if one.probabilities[-1] <= 0.5]
    for one in kept:
        overlap = view.instance_ids[one.mask]
        number = int(np.argmax(np.bincount(overlap))) if len(overlap) else 0
        right = number > 0 and mask_iou(one.mask, view.instance_ids == number) >= MIN_IOU
        small = number > 0 and number not in counted
        if small and right:
            continue  # something below the bar was found: neither right nor wrong
        tally.predicted += 1
        tally.predicted_right += right
        if right:
            tally.found_masks += 1
            tally.found_labels_right += (
                labels[int(np.argmax(one.probabilities[:-1]))] == view.things[number][0]
            )


def mask_iou(a: MaskArray, b: MaskArray) -> float:
    """Intersection over union of two masks; 0 for two empty ones."""
    union = int(np.count_nonzero(a | b))
    return int(np.count_nonzero(a & b)) / union if union else 0.0


def _rows(scene: str, tally: Tally, recogniser: Recogniser, min_views: int) -> list[dict[str, Any]]:
    def row(metric: str, mean: float, n: int, std: float = 0.0) -> dict[str, Any]:
        return {"table": TABLE, "scene": scene, "method": "furniture", "perception": "furniture",
                "metric": metric, "mean": mean, "std": std, "n": n}  # fmt: skip

    def share(metric: str, part: int, whole: int) -> dict[str, Any]:
        mean = part / whole if whole else float("nan")
        return row(metric, mean, whole, float(np.sqrt(mean * (1 - mean) / whole)) if whole else float("nan"))

    ranks = [
        int(np.count_nonzero(votes > votes[recogniser.labels.index(tally.truth[key])]))
        for key, votes in tally.votes.items()
        if tally.sightings[key] >= min_views
    ]
    seconds = np.array(tally.seconds or [np.nan]) * 1000
    return [
        share(f"mask_recall@{MIN_IOU}", tally.found_masks, tally.true_masks),
        share(f"mask_precision@{MIN_IOU}", tally.predicted_right, tally.predicted),
        share("label_top1", tally.labels_right, tally.labels),
        share("label_top1_found", tally.found_labels_right, tally.found_masks),
        share("object_top1", sum(rank < 1 for rank in ranks), len(ranks)),
        share("object_top3", sum(rank < 3 for rank in ranks), len(ranks)),
        row("frame_cpu_ms", float(np.median(seconds)), len(tally.seconds), float(seconds.std())),
        row("views", float(tally.views), tally.rooms),
    ]
