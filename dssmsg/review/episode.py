"""One episode of a recording, as rules of diagnosis see it: what was asked, understood, seen, driven."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from dssmsg.errors import InputError
from dssmsg.frame import Frame, Truth, TruthObject
from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.interfaces.source import Command
from dssmsg.recording.reader import Recording
from dssmsg.review.episode_map import MapHistory, ObjectHistory
from dssmsg.review.match import whole_match

Json = Mapping[str, Any]
MIN_PIXELS = 200
MAX_RANGE_M = 4.0
"""So much of an object, nearer than that, counts as visible (ALGORITHM, Scores)."""
_DRIVING = frozenset({"turn", "drive", "detour", "inspect", "replan", "look"})


@dataclass(frozen=True, slots=True)
class Seen:
    """A detection in a few words: its place in the frame's list, label, score."""

    index: int
    label: str
    score: float


@dataclass(frozen=True, slots=True)
class Move:
    """What a command asked for in one period, and what the poses say was done: metres and radians."""

    frame: int
    command: Command
    asked_m: float
    asked_rad: float
    moved_m: float
    turned_rad: float
    collided: bool


class ReviewedRecording(Recording):
    """A recording with what rules ask of it made once. `hides_truth`: as if no truth had been recorded."""

    hides_truth = False

    def truth(self, index: int) -> Truth | None:
        """The simulator's truth of a frame, unless it is hidden."""
        return None if self.hides_truth else super().truth(index)

    def frame(self, index: int, *, with_truth: bool = False, lazy: bool = True) -> Frame:
        """A frame; rules look at its depth, so that colours are read and decoded on first use."""
        return super().frame(index, with_truth=with_truth, lazy=lazy)

    @cached_property
    def has_truth(self) -> bool:
        """Whether there is any truth to use."""
        return any(self.truth(index) is not None for index in self.frame_indices[:1])

    @cached_property
    def history(self) -> MapHistory:
        """How the map came to be."""
        return MapHistory.of(self.change_rows())

    @cached_property
    def seen(self) -> Mapping[int, tuple[Seen, ...]]:
        """What was detected, by key frame."""
        keys = set(self.key_frames)
        return {
            frame: tuple(Seen(i, label, score) for i, (label, score) in enumerate(told))
            for frame, told in self.detected_names().items()
            if frame in keys
        }

    def evidence(self, object_ids: Collection[str]) -> Mapping[str, Mapping[int, str]]:
        """What key frames said of objects, by id and frame; the last window has the last word."""
        said: dict[str, dict[int, str]] = {name: {} for name in object_ids}
        for window in self.windows(object_ids):
            for one in window["evidence"]:
                if one["object"] in said:
                    said[one["object"]][one["frame"]] = one["verdict"]
        return said

    @cached_property
    def labels(self) -> Counter[str]:
        """How often each label was detected."""
        return Counter(one.label for seen in self.seen.values() for one in seen)

    @cached_property
    def _cases(self) -> dict[int, EpisodeCase]:
        return {}

    def case(self, episode: int) -> EpisodeCase:
        """An episode. Raises InputError, saying which there are, where it never was."""
        if episode not in self._cases:
            self._cases[episode] = EpisodeCase(self, episode)
        return self._cases[episode]


class EpisodeCase:
    """One episode, and what can be told of it from the recording; everything is worked out on first use."""

    def __init__(self, recording: ReviewedRecording, number: int) -> None:
        self.recording = recording
        self.number = number
        episodes = recording.episodes()
        self.ended: Json | None = next((e for e in episodes if e["episode"] == number), None)
        if self.ended is None:
            known = [str(e["episode"]) for e in episodes]
            some = f"its episodes: {', '.join(known[:20])}" if known else "no goal was sought in it"
            raise InputError(
                f"there is no episode {number} in the recording; {some}", file=recording.path, key="--episode"
            )
        earlier = [e["frame"] for e in episodes if e["episode"] < number]
        phases = [p["frame"] for p in recording.phases() if p["phase"] == "seek"]
        self.before: int = max([*earlier, *(min(phases) - 1,)] if phases else earlier, default=-1)
        """The frame at which the episode began: the last one before it."""
        self.last: int = int(self.ended["frame"])
        self.goal: str = str(self.ended["goal"])
        self.outcome: str = str(self.ended["outcome"])
        self.reason: str = str(self.ended["reason"])

    @cached_property
    def frames(self) -> Sequence[int]:
        """Its frames, ascending; the one that it began from is not among them."""
        return [index for index in self.recording.frame_indices if self.before < index <= self.last]

    @cached_property
    def match(self) -> Json | None:
        """The grounded query: target graph and candidates, best first; None if it never got there."""
        match = next(
            (
                match
                for match in self.recording.matches()
                if match["query"] == self.goal and self.before <= match["frame"] <= self.last
            ),
            None,
        )
        return None if match is None else whole_match(match, self.recording.path)

    @cached_property
    def calls(self) -> Sequence[Json]:
        """What the language model was asked for this goal."""
        return [
            call
            for call in self.recording.llm_calls()
            if call["role"] == "target_graph"
            and self.before <= call["frame"] <= self.last
            and self.goal in call["prompt"]
        ]

    @cached_property
    def driving(self) -> Sequence[Json]:
        """How the drive went: rows of navigation, in order.

        An episode begins at the frame at which the one before ended; what was said of that frame after its
        end belongs to the later one.
        """
        rows = [r for r in self.recording.navigation() if self.before <= r["frame"] <= self.last]
        return rows[_rows_until_end(rows, self.before) : _rows_until_end(rows, self.last, after=True)]

    @property
    def candidates(self) -> Sequence[Json]:
        """The ranked viewpoints."""
        return [] if self.match is None else self.match["candidates"]

    @property
    def core(self) -> str:
        """The label that the target graph has for what is looked for; empty without a target graph."""
        if self.match is None:
            return ""
        target = self.match["target"]
        return str(target["nodes"][target["core"]]["label"])

    @cached_property
    def wanted(self) -> frozenset[str]:
        """Labels that answer the goal: what the sentence names first; where it names nothing, the core."""
        words = words_of(self.goal)
        known = {*self.recording.labels, *self.truth_labels, self.core} - {""}
        places = {label: _place(words_of(label), words) for label in known}
        named = {label: place for label, place in places.items() if place is not None}
        if not named:
            return frozenset({self.core} - {""})
        first = min(named.values(), key=lambda place: (place[0], -place[1]))
        return frozenset(label for label, place in named.items() if place == first)

    @property
    def names_its_goal(self) -> bool:
        """Whether the goal says what is looked for, by a word that is a label of detections or truth."""
        words = words_of(self.goal)
        return any(_place(words_of(label), words) is not None for label in self.wanted)

    @cached_property
    def truth_labels(self) -> frozenset[str]:
        """Labels of everything that truly stands in the home at the end of the episode."""
        return frozenset(thing.label for thing in self.things)

    @cached_property
    def things(self) -> Sequence[TruthObject]:
        """What truly stands in the home at the end of the episode; nothing without truth."""
        truth = self.recording.truth(self.last)
        return [] if truth is None else [t for t in truth.objects if t.state != DISAPPEARED]

    @cached_property
    def answers(self) -> Sequence[TruthObject]:
        """The true objects that answer the goal."""
        return [thing for thing in self.things if same_thing(thing.label, self.wanted)]

    @cached_property
    def evidence(self) -> Mapping[str, Mapping[int, str]]:
        """What key frames said of the objects that are called what is sought, by id and frame.

        So called at the end of the recording, or when the goal was grounded.
        """
        ids = set()
        for thing in self.recording.history.objects.values():
            then = thing.label() if self.match is None else thing.label(self.match["frame"])
            if same_thing(thing.label(), self.wanted) or same_thing(then, self.wanted):
                ids.add(thing.id)
        return self.recording.evidence(ids)

    @cached_property
    def held(self) -> ObjectHistory | None:
        """What in the map the best candidate that was driven to took for the target."""
        goal = self.driven_to
        for one in self.candidates:
            if one["viewpoint"] == goal or not goal:
                core = str(self.match["target"]["core"]) if self.match else ""
                return self.recording.history.last(one["matching"].get(core, ""))
        return None

    @cached_property
    def driven_to(self) -> str:
        """The viewpoint that was driven to last, as far as the recording says; else the best candidate."""
        for row in reversed(self.driving):
            found = re.search(r"viewpoint-[0-9.]+[0-9]", row["detail"])
            if found:
                return found.group()
        return str(self.candidates[0]["viewpoint"]) if self.candidates else ""

    @cached_property
    def seen_at_end(self) -> str:
        """The label of what the robot was content with; empty where it saw nothing it looked for."""
        for row in reversed(self.driving):
            if row["state"] == "seen":
                found = re.search(r"\((.*)\)", row["detail"])
                return found.group(1) if found else ""
        return ""

    @cached_property
    def moves(self) -> Sequence[Move]:
        """What was commanded and what was done, period by period."""
        return list(moves_of(self.recording, [self.before, *self.frames]))

    @property
    def is_judged_by_truth(self) -> bool:
        """Whether the truth says if it went well."""
        return self.truly_reached is not None

    @property
    def asks_for_nothing_there(self) -> bool:
        """Whether the goal names something of which, by the truth, the home has none."""
        return bool(self.things and self.wanted and not self.answers)

    @cached_property
    def truly_reached(self) -> bool | None:
        """Whether the robot ended with an answer in view, by the truth; None where that cannot be told."""
        if not self.recording.has_truth or not self.answers:
            return None
        return self.pixels(self.last, {thing.instance_id for thing in self.answers}) >= MIN_PIXELS

    def pixels(self, frame: int, instances: Iterable[int]) -> int:
        """How many pixels of a frame show one of the true objects within range."""
        truth = self.recording.truth(frame)
        if truth is None:
            return 0
        depth = self.recording.frame(frame).depth
        near = (depth > 0) & (depth < MAX_RANGE_M)
        return int(np.count_nonzero(np.isin(truth.instance_ids, list(instances)) & near))

    @cached_property
    def touched(self) -> Move | None:
        """The first move in which the robot touched something; None if it never did."""
        return next((move for move in self.moves if move.collided), None)

    @cached_property
    def failed(self) -> bool:
        """Whether it went wrong: it failed, touched something, or was content with what is no answer."""
        return self.outcome != "success" or self.is_mistaken or self.touched is not None

    @cached_property
    def is_mistaken(self) -> bool:
        """Whether the robot called it a success and was wrong: by the truth, else by the names it used."""
        if self.outcome != "success":
            return False
        if self.truly_reached is not None:
            return not self.truly_reached
        return bool(self.wanted and self.seen_at_end) and not same_thing(self.seen_at_end, self.wanted)


def _rows_until_end(rows: Sequence[Json], frame: int, *, after: bool = False) -> int:
    """How many rows there are until what ended at a frame was over; `after`: all, where nothing says so."""
    ends = [i + 1 for i, row in enumerate(rows) if row["frame"] == frame and row["state"] not in _DRIVING]
    earlier = sum(row["frame"] < frame for row in rows)
    if ends:
        return ends[-1]
    return len(rows) if after else earlier


def moves_of(recording: ReviewedRecording, frames: Sequence[int]) -> Iterable[Move]:
    """Commands against poses over consecutive frames; the first frame is only where it began."""
    for previous, index in pairwise(frames):
        command = recording.command(index)
        if command is None or previous < 0 or recording.visit(index) != recording.visit(previous):
            continue
        period = recording.sim_time(index) - recording.sim_time(previous)
        x0, y0, heading0 = recording.floor_pose(previous)
        x1, y1, heading1 = recording.floor_pose(index)
        yield Move(
            frame=index,
            command=command,
            asked_m=command.linear * period,
            asked_rad=command.angular * period,
            moved_m=math.hypot(x1 - x0, y1 - y0),
            turned_rad=math.remainder(heading1 - heading0, math.tau),
            collided=recording.collisions(index) > recording.collisions(previous),
        )


@lru_cache(maxsize=4096)
def words_of(text: str) -> tuple[str, ...]:
    """Lower-case words without plural s."""
    words = re.findall(r"[a-z0-9]+", text.lower().replace("_", " "))
    return tuple(w[:-1] if len(w) > 3 and w.endswith("s") and not w.endswith("ss") else w for w in words)


def same_thing(label: str, wanted: Iterable[str]) -> bool:
    """Whether a label names one of the wanted things: the same, or one of its kind ("double bed", "bed")."""
    own = words_of(label)
    return any(own == (other := words_of(one)) or _ends_alike(own, other) for one in wanted)


def _ends_alike(a: tuple[str, ...], b: tuple[str, ...]) -> bool:
    short, long = sorted((a, b), key=len)
    return bool(short) and long[-len(short) :] == short


def _place(label: tuple[str, ...], words: tuple[str, ...]) -> tuple[int, int] | None:
    """Where a label stands in a sentence, and how many words it has; None where it does not."""
    for place in range(len(words) - len(label) + 1):
        if label and words[place : place + len(label)] == label:
            return place, len(label)
    return None
