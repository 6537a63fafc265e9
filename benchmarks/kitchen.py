"""What `detector: coco` makes of a folder of posed RGB-D frames: believed objects, and what is there twice.

    python benchmarks/kitchen.py FOLDER [--set KEY=VALUE ...] [--json]

Meant for the kitchen of 7-Scenes ("redkitchen"). Exit 0 if among the believed objects are one dining table,
at least three chairs and at least one cup or mug, and no two of one label at one place (centres nearer than
0.3 m and boxes that touch). Needs the model: dssmsg models get coco.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np

from dssmsg.graph.nodes import BELIEVED, ObjectNode
from dssmsg.recording.reader import Recording

MIN_DISTANCE_M = 0.3


def main() -> int:
    """Run once, print the believed objects and the verdict."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        summary = run(given.folder.absolute(), given.sets, Path(place))
        with Recording.open(Path(place) / summary["recording"]) as recording:
            graph = recording.graph_at(None)
    believed = sorted(
        (node for node in graph.objects.values() if node.status == BELIEVED), key=lambda node: node.label
    )
    counts = Counter(node.label for node in believed)
    doubles = [(a.id, b.id, a.label) for a, b in combinations(believed, 2) if at_one_place(a, b)]
    wanted = {
        "one dining table": counts["dining table"] == 1,
        "three chairs": counts["chair"] >= 3,
        "a cup or mug": counts["cup"] + counts["mug"] >= 1,
        "none twice": not doubles,
        "no errors": summary["errors"] == 0,
    }
    seconds = summary["seconds"]["perception"] / summary["key_frames"]
    if given.json:
        print(json.dumps({"believed": counts, "doubles": doubles, "met": wanted, "frame_seconds": seconds}))
    else:
        for node in believed:
            middle, size = (node.box_min + node.box_max) / 2, node.box_max - node.box_min
            votes = ", ".join(f"{label} {votes:.1f}" for label, votes in node.votes.items())
            print(f"{node.label:14} {node.id:10} at {row(middle)} size {row(size)}  votes {votes}")
        print(f"perception {1000 * seconds:.0f} ms a key frame, {summary['key_frames']} key frames")
        for name, met in wanted.items():
            print(f"{'met' if met else 'NOT MET':8}{name}")
        for first, second, label in doubles:
            print(f"twice: {label}: {first} and {second}")
    return 0 if all(wanted.values()) else 1


def run(folder: Path, sets: list[str], place: Path) -> dict:
    """The summary of a run in `place`."""
    text = {
        "name": "kitchen",
        "source": {"use": "rgbd", "path": str(folder)},
        "mission": {"phases": ["survey"]},
        "perception": {"use": "chain", "detector": {"use": "coco"}},
    }
    (place / "kitchen.yaml").write_text(json.dumps(text), encoding="utf-8")  # JSON is YAML
    command = [sys.executable, "-m", "dssmsg", "run", "kitchen.yaml", "--json"]
    for assignment in sets:
        command += ["--set", assignment]
    done = subprocess.run(command, cwd=place, stdout=subprocess.PIPE, check=False)
    if done.returncode:
        raise SystemExit(done.returncode)
    return json.loads(done.stdout)


def at_one_place(a: ObjectNode, b: ObjectNode) -> bool:
    """Whether two objects of one label are nearer than two things can be."""
    if a.label != b.label:
        return False
    between = np.linalg.norm((a.box_min + a.box_max - b.box_min - b.box_max) / 2)
    apart = (np.maximum(a.box_min, b.box_min) > np.minimum(a.box_max, b.box_max)).any()
    return bool(between < MIN_DISTANCE_M and not apart)


def row(values: np.ndarray) -> str:
    """Three metres in a line."""
    return " ".join(f"{value:6.2f}" for value in values)


if __name__ == "__main__":
    sys.exit(main())
