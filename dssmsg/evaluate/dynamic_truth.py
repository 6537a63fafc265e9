"""What changed in a recorded run, and which of it could be known: computed from the truth of its key frames.

States are relative to the end of the survey (ALGORITHM, Scores): a thing that moves and is put back is
static. Only key frames count, as perception sees no others; visible is a thing with at least 200 pixels
within 4 m in at least `MIN_FRAMES` of them. Whether a place was looked at while the thing was not there is
found out by casting the thing's own mesh against the measured depth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dssmsg.errors import DssmsgError, InputError
from dssmsg.evaluate.dynamic import Thing
from dssmsg.evaluate.static import MIN_FRAMES
from dssmsg.evaluate.visible import MIN_PIXELS, Place, VisibleTruth
from dssmsg.frame import FloatArray, Truth, TruthObject
from dssmsg.graph.nodes import APPEARED, DISAPPEARED, MOVED, STATIC
from dssmsg.recording.reader import Recording
from dssmsg.sim.camera import make_renderer
from dssmsg.sim.mesh import Mesh, box
from dssmsg.sim.robot import RobotSpec
from dssmsg.sim.scenario_source import scripted_scene
from dssmsg.sim.scenario_views import Ghosts
from dssmsg.sim.scene import Appear, Disappear, Relocate, Scene
from dssmsg.sim.scene_placement import Placed, Placer
from dssmsg.sim.script import visit_states

SHIFT_M = 0.02
"""A box whose centre is further off than this is another place."""
PUT_BACK = "put_back"


@dataclass(frozen=True, slots=True, eq=False)
class RunTruth:
    """The things of a run: as they were at the end of the survey (all static), and as they are at the end.

    `survey_end` is the last frame of the survey. `away` holds the places where things were in between that
    are back where they were, by name.
    """

    before: tuple[Thing, ...]
    after: tuple[Thing, ...]
    survey_end: int
    away: Mapping[str, tuple[Place, ...]]


def run_truth(recording: Recording, *, min_frames: int = MIN_FRAMES) -> RunTruth:
    """Read the truth of a recording with at least two visits; InputError where it holds none, or only one."""
    keys = recording.key_frames
    visible = VisibleTruth()
    truths: dict[int, Truth] = {}
    for index in keys:
        truth = recording.truth(index)
        if truth is None:
            raise InputError("the recording holds no ground truth to score against", file=recording.path)
        truths[index] = truth
        visible.add(recording.frame(index), truth)
    survey = [index for index in keys if recording.visit(index) == 0]
    later = [index for index in keys if recording.visit(index) > 0]
    if not survey or not later:
        raise InputError("expected a survey and a revisit with key frames in both", file=recording.path)
    reader = _Reader(recording, visible.places(), min_frames, _placed(recording, recording.visit(later[-1])))
    try:
        start = {known.name: known for known in truths[survey[-1]].objects if known.state != DISAPPEARED}
        after = []
        for known in truths[later[-1]].objects:
            thing = reader.thing(known, start.get(known.name), later, survey, truths)
            if thing is not None:
                after.append(thing)
    finally:
        reader.close()
    before = [reader.at_survey_end(known) for known in start.values()]
    away = {thing.name: reader.other_places(thing) for thing in after if thing.tag == PUT_BACK}
    return RunTruth(tuple(before), tuple(after), survey[-1], away)


class _Reader:
    """Works out one thing at a time."""

    def __init__(
        self, recording: Recording, places: Iterable[Place], min_frames: int, scene: _PlacedScene
    ) -> None:
        self._recording = recording
        self._min_frames = min_frames
        self._scene = scene
        self._ghosts = Ghosts(make_renderer()[0])
        self._places: dict[str, list[Place]] = {}
        for place in places:
            self._places.setdefault(place.name, []).append(place)

    def close(self) -> None:
        self._ghosts.close()

    def thing(
        self,
        known: TruthObject,
        start: TruthObject | None,
        later: Sequence[int],
        survey: Sequence[int],
        truths: Mapping[int, Truth],
    ) -> Thing | None:
        """A thing at the end, relative to the survey's; None for one that was gone before that already."""
        there = known.state != DISAPPEARED
        if start is None and not there:
            return None
        tag = self._scene.tags.get(known.name, "")
        now = self._place(known)
        if start is not None and there and _same_place(known, start):
            return self._unchanged(now, known, later, truths, tag)
        since = _since(known, later, truths)
        if start is None:
            looked_before = self._looked(known.name, now, survey, self._scene.after)
            counted = self._enough(now) and looked_before
            return Thing(known.name, known.label, APPEARED, now, counted=counted, tag=tag)
        old = self._place(start)
        known_before = self._seen_in(old, survey=True)
        left_seen = self._looked(known.name, old, since, self._scene.before)
        if not there:
            return Thing(
                known.name, known.label, DISAPPEARED, old, counted=known_before and left_seen, tag=tag
            )
        arrived_seen = self._enough(now)
        if left_seen and not arrived_seen:
            # All that anybody could learn is that it is gone.
            return Thing(known.name, known.label, DISAPPEARED, old, counted=known_before, tag=tag)
        counted = known_before and arrived_seen
        return Thing(known.name, known.label, MOVED, now, old, counted, former_seen=left_seen, tag=tag)

    def at_survey_end(self, start: TruthObject) -> Thing:
        """A thing as the survey left it."""
        place = self._place(start)
        return Thing(start.name, start.label, STATIC, place, counted=self._seen_in(place, survey=True))

    def other_places(self, thing: Thing) -> tuple[Place, ...]:
        """Where else a thing was seen in the run."""
        return tuple(place for place in self._places.get(thing.name, ()) if place is not thing.place)

    def _unchanged(
        self,
        now: Place,
        known: TruthObject,
        later: Sequence[int],
        truths: Mapping[int, Truth],
        tag: str,
    ) -> Thing:
        moved_between = len(_since(known, later, truths)) < len(later)
        # What was away and is back is judged by itself: its life, not its state at the end.
        counted = self._enough(now) and not moved_between
        retained = counted and self._seen_in(now, survey=True) and self._seen_in(now, survey=False)
        return Thing(known.name, known.label, STATIC, now, counted=counted, retained=retained, tag=tag)

    def _place(self, known: TruthObject) -> Place:
        for place in self._places.get(known.name, ()):
            if _same_box(place.box_min, place.box_max, known.box_min, known.box_max):
                return place
        return Place(known.name, known.label, known.state, 0, known.box_min, known.box_max, None, None)

    def _enough(self, place: Place) -> bool:
        return place.frames >= self._min_frames

    def _seen_in(self, place: Place, *, survey: bool) -> bool:
        frames = sum(count for visit, count in place.visits.items() if (visit == 0) == survey)
        return frames >= self._min_frames

    def _looked(self, name: str, place: Place, indices: Sequence[int], known: Mapping[str, Placed]) -> bool:
        """Whether enough of the frames would have shown the thing at the place, had it been there."""
        mesh, pose = _mesh_at(place, known.get(name))
        count = 0
        for index in indices:
            frame = self._recording.frame(index)
            pixels = self._ghosts.pixels(mesh, pose, frame.camera, frame.world_from_camera, frame.depth)
            count += pixels >= MIN_PIXELS
            if count >= self._min_frames:
                return True
        return False


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedScene:
    """The simulated furniture at the end of the survey and of the run, and what the changes exemplify."""

    before: Mapping[str, Placed]
    after: Mapping[str, Placed]
    tags: Mapping[str, str]


def _placed(recording: Recording, last_visit: int) -> _PlacedScene:
    """The furniture of a simulated run, placed again from its configuration; empty for other sources."""
    source = recording.config["source"]
    if source["use"] != "pybullet":
        return _PlacedScene({}, {}, {})
    try:
        scripted = scripted_scene(
            source["scene"],
            assets=source["assets"],
            changes=source["changes"],
            counts=source["change_counts"],
            visits=source["visits"],
            renderer=source["renderer"],
            robot=RobotSpec(camera_height=source["camera_height"], camera_forward=source["camera_forward"]),
            base_dir=Path.cwd(),
        )
        if source["changes"] == "none":
            return _PlacedScene({}, {}, {})
        placer = Placer(scripted.scene, scripted.library)
        before, after = (visit_states(scripted.scene, placer, visit)[-1] for visit in (0, last_visit))
    except DssmsgError:  # the scene's file has gone, or the furniture: boxes stand in for the meshes
        return _PlacedScene({}, {}, {})
    return _PlacedScene(before, after, change_tags(scripted.scene))


def change_tags(scene: Scene) -> dict[str, str]:
    """What each piece's changes are examples of, by its name."""
    tags = {}
    for change in scene.changes:
        if isinstance(change, Appear):
            tags[change.piece.id] = change.tag
        elif isinstance(change, Disappear | Relocate):
            tags[change.object] = change.tag
    return tags


def _since(known: TruthObject, later: Sequence[int], truths: Mapping[int, Truth]) -> list[int]:
    """The frames at the end of `later` in which a thing already was as it is at the end."""
    since: list[int] = []
    for index in reversed(later):
        then = next((one for one in truths[index].objects if one.name == known.name), None)
        if then is None or (then.state == DISAPPEARED) != (known.state == DISAPPEARED):
            break
        if known.state != DISAPPEARED and not _same_place(then, known):
            break
        since.append(index)
    return since[::-1]


def _same_place(one: TruthObject, other: TruthObject) -> bool:
    return _same_box(one.box_min, one.box_max, other.box_min, other.box_max)


def _same_box(low: FloatArray, high: FloatArray, other_low: FloatArray, other_high: FloatArray) -> bool:
    return bool(max(np.abs(low - other_low).max(), np.abs(high - other_high).max()) <= SHIFT_M)


def _mesh_at(place: Place, piece: Placed | None) -> tuple[Mesh, FloatArray]:
    """The mesh that stood at a place, with its pose; a box of that size if it is not known."""
    if piece is not None and _same_box(piece.box_min, piece.box_max, place.box_min, place.box_max):
        return piece.model.mesh, piece.world_from_object
    pose = np.eye(4)
    pose[:3, 3] = (place.box_min + place.box_max) / 2
    sides = [float(side) for side in place.box_max - place.box_min]
    return box(sides, (128, 128, 128), center=(0.0, 0.0, 0.0)), pose
