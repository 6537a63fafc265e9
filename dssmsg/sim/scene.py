"""A scene as a file: rooms, doors, furniture, the survey tour, scripted changes and queries.

Everything here is plain data, validated and frozen; what it becomes in three dimensions is worked out in
`scene_layout` (walls and doors) and `scene_placement` (furniture). World axes: x east, y north, z up,
metres; angles in the file are degrees counter-clockwise, because a person writes them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from dssmsg.config_yaml import MAX_BYTES, parse_yaml
from dssmsg.errors import ConfigError, InputError

STOCK_SCENES = ("rs_int", "ihlen_1_int")
Side = Literal["north", "east", "south", "west"]
Interval = tuple[float, float]
Color = tuple[int, int, int]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=60)]
PieceId = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*-[0-9]+$", max_length=60)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Room(_Part):
    """A rectangular room; `x` and `y` are the insides of its walls."""

    name: Name = Field(description="unique name, used by doors, furniture and stops")
    type: str = Field(description="what the room is: living room, kitchen, bedroom, corridor, ...")
    x: Interval = Field(description="west and east inner wall, metres")
    y: Interval = Field(description="south and north inner wall, metres")
    floor_color: Color | None = Field(default=None, description="RGB of the floor; by room type if absent")
    wall_color: Color | None = Field(default=None, description="RGB of the walls; by room type if absent")

    @field_validator("x", "y")
    @classmethod
    def _ordered(cls, value: Interval) -> Interval:
        if not 0.5 <= value[1] - value[0] <= 50.0:
            raise ValueError("expected [low, high] with 0.5 to 50 m between them")
        return value

    @property
    def center(self) -> tuple[float, float]:
        """Middle of the floor, world metres."""
        return (sum(self.x) / 2, sum(self.y) / 2)

    @property
    def area(self) -> float:
        """Floor area, square metres."""
        return (self.x[1] - self.x[0]) * (self.y[1] - self.y[0])

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether a floor point lies inside, at least `margin` metres from the walls."""
        return self.x[0] + margin <= x <= self.x[1] - margin and self.y[0] + margin <= y <= self.y[1] - margin


class Leaf(_Part):
    """A door leaf standing open."""

    into: Name = Field(description="the room it opens into")
    hinge: Literal["low", "high"] = Field(default="low", description="which end of the opening it hangs at")
    angle_deg: float = Field(default=90.0, ge=0.0, le=180.0, description="0 is closed, 90 off the wall")


class Door(_Part):
    """An opening in the wall between two rooms; with a `leaf` it is a door."""

    name: Name = Field(description="unique name")
    between: tuple[Name, Name] = Field(description="the two rooms, whose walls must face each other")
    along: float = Field(description="centre of the opening along the wall, world x or y")
    width: float = Field(default=0.8, ge=0.5, le=6.0, description="clear width, metres")
    height: float = Field(default=2.05, ge=1.5, le=4.0, description="clear height, metres")
    leaf: Leaf | None = Field(default=None, description="the leaf, if there is one")


class Placement(_Part):
    """Where a piece stands. Exactly one of `at` alone, `wall` with `along`, or `on` (with offsets `at`).

    A piece's front faces -y at yaw 0. Against a wall it turns its back to it and `yaw_deg` adds to that.
    """

    at: tuple[float, float] | None = Field(
        default=None, description="world x, y of the centre; with `on`: offset in the support's own axes"
    )
    wall: str | None = Field(
        default=None,
        pattern=r"^[a-z][a-z0-9_]*\.(north|east|south|west)$",
        description="`room.side` to stand at",
    )
    along: float | None = Field(
        default=None, description="metres from the wall's west or south end to the piece's centre"
    )
    gap: float = Field(default=0.01, ge=0.0, le=3.0, description="metres between the wall and the back")
    on: PieceId | None = Field(default=None, description="the piece that carries this one")
    z: float | None = Field(
        default=None, ge=0.0, le=4.0, description="height of the bottom above the floor; else it rests"
    )
    yaw_deg: float = Field(default=0.0, ge=-360.0, le=360.0, description="turn, counter-clockwise")

    @model_validator(mode="after")
    def _one_way(self) -> Placement:
        if self.wall is not None:
            if self.along is None or self.at is not None or self.on is not None:
                raise ValueError("`wall` needs `along` and excludes `at` and `on`")
        elif self.along is not None:
            raise ValueError("`along` needs `wall: room.side`")
        elif self.at is None and self.on is None:
            raise ValueError("a place is missing: give `at: [x, y]`, `wall` with `along`, or `on: id`")
        return self


class Piece(Placement):
    """One piece of furniture or thing."""

    id: PieceId = Field(description="unique id like mug-1")
    category: str = Field(description="furniture category, see `dssmsg doctor`", min_length=1)
    model: str | None = Field(default=None, description="a model of that category; the first if absent")
    size: tuple[float, float, float] | None = Field(
        default=None, description="width, depth, height in metres; the model's own if absent"
    )
    movable: bool | None = Field(default=None, description="whether people move it; by category if absent")

    @field_validator("size")
    @classmethod
    def _positive(cls, value: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        if value is not None and not all(0.005 <= part <= 10.0 for part in value):
            raise ValueError("expected three lengths between 0.005 and 10 m")
        return value


class TourStop(_Part):
    """Where the robot stands and looks during the survey."""

    name: Name = Field(description="unique name")
    at: tuple[float, float] = Field(description="world x, y")
    views: tuple[tuple[float, float], ...] = Field(
        min_length=1, description="[heading, tilt] in degrees; heading from world x, negative tilt = down"
    )
    via: tuple[tuple[float, float], ...] = Field(
        default=(), description="corner points to drive through on the way from the stop before"
    )

    @field_validator("views")
    @classmethod
    def _angles(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        for heading, tilt in value:
            if abs(heading) > 360 or not -80 <= tilt <= 80:
                raise ValueError("expected [heading, tilt] within +-360 and +-80 degrees")
        return value


class _Change(_Part):
    """When a scripted change happens: before a visit begins, or during one at a stop or a time."""

    before_visit: int | None = Field(default=None, ge=1, description="made between visits, before this one")
    during_visit: int | None = Field(default=None, ge=0, description="made while this visit is driven")
    at_stop: Name | None = Field(default=None, description="when the robot comes within 0.3 m of this stop")
    at_time: float | None = Field(default=None, ge=0.0, description="sim seconds after the visit began")
    tag: str = Field(default="", max_length=20, description="what it is an example of: near, far, swap, ...")

    @model_validator(mode="after")
    def _one_time(self) -> _Change:
        if (self.before_visit is None) == (self.during_visit is None):
            raise ValueError("give exactly one of `before_visit` and `during_visit`")
        trigger = (self.at_stop is not None) + (self.at_time is not None)
        if trigger != (self.during_visit is not None):
            raise ValueError("`during_visit` needs one of `at_stop` and `at_time`; `before_visit` none")
        return self

    @property
    def visit(self) -> int:
        """The visit that first shows the change."""
        return self.during_visit if self.during_visit is not None else (self.before_visit or 0)


class Appear(_Change):
    """A piece that was not there comes in."""

    kind: Literal["appear"]
    piece: Piece = Field(description="the new piece")


class Disappear(_Change):
    """A piece is taken away."""

    kind: Literal["disappear"]
    object: PieceId = Field(description="the piece")


class Relocate(_Change):
    """A piece is put somewhere else."""

    kind: Literal["relocate"]
    object: PieceId = Field(description="the piece")
    to: Placement = Field(description="its new place")


class DoorChange(_Change):
    """A door is closed, or stands open again. One without a leaf slides out of the wall."""

    kind: Literal["door"]
    door: Name = Field(description="the door")
    closed: bool = Field(default=True, description="false: opened again")

    @model_validator(mode="after")
    def _between_visits(self) -> DoorChange:
        if self.before_visit is None:
            raise ValueError("a door changes between visits: give `before_visit`")
        return self


class LightChange(_Change):
    """The light changes in the whole home; 1 is how every scene begins."""

    kind: Literal["light"]
    level: float = Field(ge=0.1, le=1.5, description="what all colours are multiplied by, up to white")


Change = Annotated[Appear | Disappear | Relocate | DoorChange | LightChange, Field(discriminator="kind")]


class Obstacle(_Part):
    """A piece that appears ahead of the robot when it drives towards the piece's place."""

    piece: Piece = Field(description="the piece and its place, floor only")
    within: float = Field(
        default=2.5, ge=1.6, le=6.0, description="appears when the robot is this near, metres (not below 1.5)"
    )
    from_visit: int = Field(default=0, ge=0, description="the first visit in which it may appear")

    @model_validator(mode="after")
    def _on_the_floor(self) -> Obstacle:
        if self.piece.on is not None:
            raise ValueError("an obstacle stands on the floor: give `at` or `wall` with `along`, not `on`")
        return self


class Query(_Part):
    """A sentence with the pieces that answer it."""

    text: str = Field(min_length=3, description="what a person asks for")
    targets: tuple[PieceId, ...] = Field(min_length=1, description="ids of the pieces that answer it")
    kind: Literal["explicit", "implicit"] = Field(default="explicit", description="does it name the object")


class Scene(_Part):
    """A furnished home, its survey tour and what happens in it."""

    name: Name = Field(description="name of the scene")
    wall_height: float = Field(default=2.6, ge=2.0, le=6.0, description="floor to ceiling, metres")
    wall_thickness: float = Field(default=0.1, ge=0.04, le=0.5, description="metres")
    rooms: tuple[Room, ...] = Field(min_length=1)
    doors: tuple[Door, ...] = ()
    furniture: tuple[Piece, ...] = ()
    tour: tuple[TourStop, ...] = Field(default=(), description="the survey, in driving order")
    changes: tuple[Change, ...] = ()
    queries: tuple[Query, ...] = ()
    obstacles: tuple[Obstacle, ...] = Field(default=(), description="what appears ahead of the robot")

    @model_validator(mode="after")
    def _references(self) -> Scene:
        for what, names in (
            ("room", [r.name for r in self.rooms]),
            ("door", [d.name for d in self.doors]),
            ("stop", [s.name for s in self.tour]),
            ("piece", [p.id for p in self.pieces()]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{what} named twice: {', '.join(twice)}")
        rooms, stops = {r.name for r in self.rooms}, {s.name for s in self.tour}
        pieces = {p.id for p in self.pieces()}
        for door in self.doors:
            _known(f"doors.{door.name}.between", door.between, rooms)
            if door.leaf is not None:
                _known(f"doors.{door.name}.leaf.into", [door.leaf.into], set(door.between))
        for piece in self.furniture:
            _known(f"furniture.{piece.id}.on", [piece.on] if piece.on else [], {p.id for p in self.furniture})
            _known(f"furniture.{piece.id}.wall", [piece.wall.split(".")[0]] if piece.wall else [], rooms)
        for index, change in enumerate(self.changes):
            place = change.piece if isinstance(change, Appear) else getattr(change, "to", None)
            if place is not None:
                _known(f"changes.{index}.on", [place.on] if place.on else [], pieces)
                _known(f"changes.{index}.wall", [place.wall.split(".")[0]] if place.wall else [], rooms)
            if isinstance(change, Disappear | Relocate):
                _known(f"changes.{index}.object", [change.object], pieces)
            if isinstance(change, DoorChange):
                _known(f"changes.{index}.door", [change.door], {door.name for door in self.doors})
            _known(f"changes.{index}.at_stop", [change.at_stop] if change.at_stop else [], stops)
        for index, query in enumerate(self.queries):
            _known(f"queries.{index}.targets", query.targets, pieces)
        return self

    def pieces(self) -> Iterator[Piece]:
        """Every piece that ever is in the scene, those that appear last; the order fixes instance ids."""
        yield from self.furniture
        for change in self.changes:
            if isinstance(change, Appear):
                yield change.piece
        for obstacle in self.obstacles:
            yield obstacle.piece

    def room(self, name: str) -> Room:
        """The room of that name (KeyError if there is none)."""
        for room in self.rooms:
            if room.name == name:
                return room
        raise KeyError(name)

    def room_at(self, x: float, y: float) -> str:
        """Name of the room a floor point lies in, or '' in a doorway or outside."""
        return next((room.name for room in self.rooms if room.contains(x, y)), "")


def _known(where: str, names: Any, known: set[str]) -> None:
    for name in names:
        if name not in known:
            listed = ", ".join(sorted(known)[:12]) or "none"
            raise ValueError(f"{where}: unknown name {name!r}; known: {listed}")


def load_scene(name: str, *, base_dir: Path | None = None) -> Scene:
    """The scene called `name`: a stock scene, `generated:<seed>`, or a path to a YAML file.

    Relative paths resolve against `base_dir` (the working directory if absent). Raises ConfigError with
    key `source.scene` for an unknown name and InputError for a file that is not a valid scene.
    """
    if name in STOCK_SCENES:
        text = (resources.files("dssmsg") / "data" / "scenes" / f"{name}.yaml").read_text(encoding="utf-8")
        return parse_scene(text, file=f"{name}.yaml")
    seed = generated_seed(name)
    if seed is not None:
        from dssmsg.sim.generate import generate_scene

        return generate_scene(seed)
    if not name.endswith((".yaml", ".yml")):
        choices = ", ".join((*STOCK_SCENES, "generated:<seed>", "or a path to a .yaml file"))
        raise ConfigError(f"unknown scene {name!r}; known: {choices}", key="source.scene")
    path = Path(name)
    path = path if path.is_absolute() else (base_dir or Path.cwd()) / path
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"larger than {MAX_BYTES:,} bytes", file=path, key="source.scene")
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError("no such scene file", file=path, key="source.scene") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the scene file: {error}", file=path, key="source.scene") from None
    return parse_scene(text, file=path)


def generated_seed(name: str) -> int | None:
    """The seed of `generated:<seed>`; None for another scene. Raises ConfigError as `load_scene` does."""
    kind, _, seed = name.partition(":")
    if kind != "generated":
        return None
    if not re.fullmatch(r"[0-9]{1,9}", seed):
        raise ConfigError(
            f"expected generated:<seed> with a seed of 1 to 9 digits, got {name!r}", key="source.scene"
        )
    return int(seed)


def parse_scene(text: str, *, file: Path | str) -> Scene:
    """A scene from YAML text; InputError names the first wrong key of `file`."""
    try:
        data = parse_yaml(text, file=file)  # in which `on: table-1` keeps its key
    except ConfigError as error:
        raise InputError(error.message, file=file) from None
    if not isinstance(data, dict):
        raise InputError("expected a mapping with rooms, doors, furniture, tour, ...", file=file)
    try:
        return Scene.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or None
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise InputError(first["msg"].removeprefix("Value error, ") + more, file=file, key=key) from None
