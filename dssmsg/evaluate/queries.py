"""Sentences with known answers: the packaged sets of both scenes, and generated ones from the truth."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib import resources
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dssmsg.config_yaml import parse_yaml
from dssmsg.errors import ConfigError
from dssmsg.frame import TruthObject
from dssmsg.geometry import box_distance
from dssmsg.sim.scene import load_scene

FOLDER = "data/queries"
KINDS = ("explicit", "implicit")
SETS = ("first", "second")
GENERATED = "generated"
_CONTACT_M, _BESIDE_M = 0.06, 0.4


class Query(BaseModel):
    """A sentence and the names of the true objects that answer it, any one of several.

    `set` is `first` where it was written before the offline parser's tables were looked at, `second` where it
    was written afterwards, `generated` where a template wrote it.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    text: str = Field(min_length=1, max_length=200)
    kind: Literal["explicit", "implicit"]
    targets: tuple[str, ...] = Field(min_length=1)
    set: Literal["first", "second", "generated"]


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    scene: str
    queries: tuple[Query, ...]


def load_queries(scene: str) -> tuple[Query, ...]:
    """The packaged queries of a scene.

    Raises ConfigError if there are none for it, or one names a target that the scene does not have.
    """
    file = resources.files("dssmsg").joinpath(f"{FOLDER}/{scene}.yaml")
    if not file.is_file():
        known = sorted(one.name.removesuffix(".yaml") for one in file.parent.iterdir())  # type: ignore[attr-defined]
        raise ConfigError(f"no query set for '{scene}'; there is one for {', '.join(known)}", key="--scenes")
    try:
        queries = _File.model_validate(parse_yaml(file.read_text("utf-8"), file=f"{scene}.yaml")).queries
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ConfigError(f"{FOLDER}/{scene}.yaml: {place}: {first['msg']}", key="--scenes") from None
    pieces = {piece.id for piece in load_scene(scene).pieces()}
    for query in queries:
        for target in query.targets:
            if target not in pieces:
                raise ConfigError(f"{query.text!r} asks for {target}, which {scene} has not", key="--scenes")
    return queries


def generated_queries(objects: Sequence[TruthObject], count: int, seed: int) -> tuple[Query, ...]:
    """Up to `count` sentences like "the mug on the desk" that hold for the true objects as they stand.

    Every relation between two boxes, and every room, gives one sentence a pair of labels; its targets are all
    objects for which it is true. Which are taken, if there are more, depends on the seed.
    """
    here = [one for one in objects if one.state != "disappeared"]
    targets: defaultdict[str, set[str]] = defaultdict(set)
    for text, name in itertools.chain(_of_pairs(here), _of_rooms(here)):
        targets[text].add(name)
    texts = sorted(targets)
    if len(texts) > count:
        chosen = np.random.default_rng(seed).choice(len(texts), count, replace=False)
        texts = [texts[place] for place in sorted(chosen)]
    return tuple(
        Query(text=text, kind="explicit", targets=tuple(sorted(targets[text])), set="generated")
        for text in texts
    )


def _of_pairs(objects: Sequence[TruthObject]) -> Iterator[tuple[str, str]]:
    for a, b in itertools.permutations(objects, 2):
        word = _relation(a, b)
        if word is not None and a.label != b.label:
            yield f"the {a.label} {word} the {b.label}", a.name


def _of_rooms(objects: Sequence[TruthObject]) -> Iterator[tuple[str, str]]:
    """Rooms by their type: the second of two bedrooms is a bedroom, too."""
    for one in objects:
        room = one.room.rstrip("0123456789").rstrip("_").replace("_", " ")
        if room:
            room = {"living": "living room", "dining": "dining room"}.get(room, room)
            yield f"the {one.label} in the {room}", one.name


def _relation(a: TruthObject, b: TruthObject) -> str | None:
    """The word for two true boxes that nobody would argue about; None where there is none."""
    shared = np.minimum(a.box_max, b.box_max) - np.maximum(a.box_min, b.box_min)
    plan = float(np.prod(np.maximum(shared[:2], 0.0)))
    own = float(np.prod((a.box_max - a.box_min)[:2]))
    bottom, top = float(a.box_min[2]), float(b.box_max[2])
    over = plan >= 0.5 * own
    if over and abs(bottom - top) <= _CONTACT_M:
        return "on"
    if over and bottom > top + _CONTACT_M:
        return "above"
    level = float(shared[2]) > 0.1
    near = float(box_distance(a.box_min, a.box_max, b.box_min, b.box_max)) <= _BESIDE_M
    return "next to" if level and near and plan == 0.0 else None
