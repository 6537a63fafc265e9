# ruff: noqa: E402  (threads must be set before numpy is imported)
"""What perception finds of what is visible, by category and by size, on the key frames of recordings.

    python benchmarks/recall.py RECORDING... [--frames 120] [--weights FOLDER] [--recorded]

The recordings must hold frames with the truth of the simulator; of each, `--frames` key frames evenly spread
are looked at. The plug-in `furniture` with its default options looks at them anew, with the weights of
`--weights` if given; `--recorded` takes the detections that the recording has. Visible is what has at least
200 pixels with a reading nearer than 4 m. A thing is found where a mask has an IoU of 0.5 with it, both
without the pixels that have no such reading; its name is right where that mask's first label is the truth's.
"""

from __future__ import annotations

import argparse
import logging
import math
import os
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported: one thread

import numpy as np
from dssmsg_plugins.perception.furniture import Furniture, FurnitureConfig

from dssmsg.evaluate.perception import MIN_IOU, mask_iou
from dssmsg.evaluate.visible import MAX_RANGE_M, MIN_PIXELS
from dssmsg.frame import Detection, Frame, Truth
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.interfaces import Context
from dssmsg.recording.reader import Recording

Row = tuple[Frame, Truth, Sequence[Detection]]
Counts = dict[str, list[int]]


def context() -> Context:
    """What the plug-in is given; without an encoder its own labels are the names."""
    here = Path()
    return Context(
        seed=0, rng=np.random.default_rng(0), graph=SceneGraph(), ids=IdAllocator(),
        log=logging.getLogger("recall"), base_dir=here, run_dir=here, run_id="recall",
        build=lambda kind, slot: None,
    )  # fmt: skip


def rows(paths: Sequence[Path], count: int, plugin: Furniture | None, seconds: list[float]) -> Iterator[Row]:
    """Key frames with their truth and detections: the plug-in's, whose CPU times go to `seconds`, or those
    recorded."""
    for path in paths:
        with Recording.open(path) as recording:
            key = list(recording.key_frames)
            for place in np.unique(np.linspace(0, len(key) - 1, min(count, len(key))).astype(int)):
                frame, truth = recording.frame(key[place]), recording.truth(key[place])
                if truth is None:
                    continue
                start = process_time()
                found = recording.detections(key[place]) if plugin is None else plugin.detect(frame)
                seconds.append(process_time() - start)
                yield frame, truth, found or ()


def tally(counts: Counts, row: Row) -> tuple[int, int]:
    """Add one frame: [visible, found, right name] by key. Gives the detections and how many are a thing."""
    frame, truth, found = row
    near = (frame.depth > 0) & (frame.depth < MAX_RANGE_M)
    masks = [one.mask & near for one in found]
    right = 0
    for mask in masks:
        number = int(np.argmax(np.bincount(truth.instance_ids[mask]))) if mask.any() else 0
        right += number > 0 and mask_iou(mask, (truth.instance_ids == number) & near) >= MIN_IOU
    for thing in truth.objects:
        whole = (truth.instance_ids == thing.instance_id) & near
        pixels = int(np.count_nonzero(whole))
        if pixels < MIN_PIXELS:
            continue
        overlaps = [mask_iou(mask, whole) for mask in masks]
        best = int(np.argmax(overlaps)) if overlaps else -1
        hit = best >= 0 and overlaps[best] >= MIN_IOU
        kind = "movable" if thing.movable else "static"
        size = MIN_PIXELS << min(int(math.log2(pixels / MIN_PIXELS)), 6)
        for key in (kind, f"{kind} from {size:5d} px", f"{kind}: {thing.label}"):
            number_of = counts[key]
            number_of[0] += 1
            number_of[1] += hit
            number_of[2] += hit and found[best].label == thing.label
    return len(masks), right


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--frames", type=int, default=120, help="key frames of each recording")
    parser.add_argument("--weights", type=Path, default=None, help="folder of other weights")
    parser.add_argument("--recorded", action="store_true", help="judge the recorded detections")
    given = parser.parse_args()
    weights = None if given.weights is None else str(given.weights.resolve())
    plugin = None if given.recorded else Furniture(
        FurnitureConfig(weights=weights), context()
    )  # fmt: skip
    counts: Counts = defaultdict(lambda: [0, 0, 0])
    seconds: list[float] = []
    detections = right = 0
    for row in rows(given.recordings, given.frames, plugin, seconds):
        made, good = tally(counts, row)
        detections += made
        right += good
    if not seconds:
        parser.exit(1, "none of the recordings has key frames with truth\n")
    print(f"{'':32s}visible  recall  right name if found")
    for key, (visible, found, named) in sorted(counts.items()):
        print(f"{key:32s}{visible:7d}  {found / visible:6.2f}  {named / found if found else math.nan:6.2f}")
    print(f"{detections} detections, {right / max(detections, 1):.3f} of them one thing; "
          f"{1000 * float(np.median(seconds)):.0f} ms CPU a frame")  # fmt: skip


if __name__ == "__main__":
    main()
