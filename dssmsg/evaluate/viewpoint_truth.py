"""Which viewpoints of a recording truly show an object: at least 200 px of it within 4 m."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from dssmsg.errors import InputError
from dssmsg.evaluate.visible import MAX_RANGE_M, MIN_PIXELS
from dssmsg.frame import FloatArray, TruthObject
from dssmsg.recording.reader import Recording

_SAME_PLACE_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class _Sight:
    """One key frame of a viewpoint that shows an object, and where the object was then."""

    frame: int
    viewpoint: str
    center: FloatArray


class ViewpointTruth:
    """Truth of all key frames of a recording, read once. Raises InputError where it holds none."""

    def __init__(self, recording: Recording) -> None:
        self._sights: dict[str, list[_Sight]] = {}
        self._states: dict[str, list[tuple[int, TruthObject]]] = {}
        for index in recording.key_frames:
            truth = recording.truth(index)
            if truth is None:
                continue
            self._remember(index, truth.objects)
            viewpoint = recording.viewpoint(index)
            if viewpoint is None:
                continue
            depth = recording.frame(index).depth
            near = truth.instance_ids[(depth > 0) & (depth < MAX_RANGE_M)]
            most = max((known.instance_id for known in truth.objects), default=0)
            pixels = np.bincount(near.ravel(), minlength=most + 1)
            for known in truth.objects:
                if known.state != "disappeared" and pixels[known.instance_id] >= MIN_PIXELS:
                    sight = _Sight(index, viewpoint, (known.box_min + known.box_max) / 2)
                    self._sights.setdefault(known.name, []).append(sight)
        if not self._states:
            raise InputError("the recording holds no ground truth to score against", file=recording.path)

    def objects(self, frame: int) -> Mapping[str, TruthObject]:
        """Every object by name as it was at a frame; one that was gone by then as it was last."""
        latest: dict[str, TruthObject] = {}
        for name, states in self._states.items():
            for index, known in states:
                if index <= frame and (name not in latest or known.state != "disappeared"):
                    latest[name] = known
        return latest

    def gone(self, frame: int) -> frozenset[str]:
        """Names of the objects that were no longer there at a frame."""
        last = {
            name: [known for index, known in states if index <= frame]
            for name, states in self._states.items()
        }
        return frozenset(name for name, known in last.items() if known and known[-1].state == "disappeared")

    def _remember(self, index: int, objects: Iterable[TruthObject]) -> None:
        for known in objects:
            states = self._states.setdefault(known.name, [])
            if not states or _differs(states[-1][1], known):
                states.append((index, known))

    def showing(self, targets: Iterable[str], frame: int) -> frozenset[str]:
        """Viewpoints that up to a frame showed one of the targets where it was then, or was last."""
        known = self.objects(frame)
        found = set()
        for name in targets:
            if name not in known:
                continue
            place = (known[name].box_min + known[name].box_max) / 2
            found |= {
                sight.viewpoint
                for sight in self._sights.get(name, ())
                if sight.frame <= frame and np.linalg.norm(sight.center - place) <= _SAME_PLACE_M
            }
        return frozenset(found)


def _differs(a: TruthObject, b: TruthObject) -> bool:
    same_box = np.allclose(a.box_min, b.box_min, atol=1e-3) and np.allclose(a.box_max, b.box_max, atol=1e-3)
    return a.state != b.state or not same_box
