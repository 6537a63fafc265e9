"""The configuration of a run: YAML files, environment and `--set` to one frozen, validated `RunConfig`.

    config = load_config(Path("my.yaml"), sets=["perception.use=oracle"])

Precedence, lowest first: the packaged `dssmsg.yaml`, included files, the file, the environment
(`DSSMSG__ASSOCIATION__USE=dssm`), `--set`. Options of a plug-in (everything but `use` in a slot) are
validated by the plug-in's own model, in `dssmsg.host`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    StringConstraints,
    field_validator,
    model_validator,
)

from dssmsg.config_errors import validate
from dssmsg.config_layers import Layer, environment_layers, file_layers, merge, origin, set_layers
from dssmsg.config_yaml import describe, dump_yaml
from dssmsg.errors import DssmsgError

LOCAL_FILE = "dssmsg.yaml"
SLOT_KINDS = (
    "source",
    "perception",
    "encoder",
    "llm",
    "association",
    "update",
    "grounding",
    "navigation",
)
"""The kinds of which a run has exactly one, in the order in which they are written."""

Text = Annotated[str, Field(min_length=1, max_length=500)]
Sentence = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=500)]


class Slot(BaseModel):
    """Which plug-in takes a place, and its options; written flat: `{use: dssm, delta_sim: 1.1}`."""

    model_config = ConfigDict(frozen=True, extra="allow")

    use: str = Field(
        min_length=1,
        description="A registered name, `package.module:Class`, or `path/to/file.py:Class`.",
    )

    @model_validator(mode="before")
    @classmethod
    def _is_mapping(cls, value: Any) -> Any:
        if isinstance(value, str):
            raise ValueError(f"expected a mapping; write {{use: {value}}}")
        return value

    @property
    def options(self) -> Mapping[str, Any]:
        """Everything but `use`, not yet validated: that is the plug-in's own model's business."""
        return MappingProxyType(self.model_extra or {})

    def flat(self) -> dict[str, Any]:
        """The slot as it is written in YAML."""
        return {"use": self.use, **self.options}


class MissionConfig(BaseModel):
    """What the robot does: phases in order, and how it drives and looks."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    phases: tuple[Literal["survey", "revisit", "seek"], ...] = Field(
        default=("survey", "revisit"),
        min_length=1,
        max_length=20,
        description="In order: survey (build the map), revisit (another visit), seek (drive to the goals).",
    )
    goals: tuple[Sentence, ...] = Field(
        default=(), max_length=100, description="Sentences to ground and drive to, for seek."
    )
    max_frames: int = Field(
        default=1200, ge=1, le=1_000_000, description="Frames of the whole run, all phases together."
    )
    seek_visit: Literal["same", "next"] = Field(
        default="same", description="Whether seek belongs to the visit before it or begins a new one."
    )
    candidates: int = Field(
        default=5, ge=1, le=100, description="Viewpoints that an episode of seek may look from."
    )
    episode_secs: float = Field(
        default=300.0, gt=0, description="An episode that takes longer ends `out of time`, sim seconds."
    )
    episode_metres: float = Field(
        default=100.0, gt=0, description="An episode that drives further ends `out of time`, metres."
    )
    linear_speed: float = Field(
        default=0.5, gt=0, le=0.5, description="Top driving speed, m/s (the robot's limit is 0.5)."
    )
    angular_speed: float = Field(
        default=1.2, gt=0, le=1.57, description="Top turning speed, rad/s (the robot's limit is 1.57)."
    )
    views_per_heading: int = Field(
        default=3, ge=1, le=9, description="Key frames taken around each heading at a stop."
    )
    heading_step_deg: float = Field(
        default=6.0,
        ge=5.0,
        le=30.0,
        description="Degrees between these key frames (ALGORITHM A.6: at least 5).",
    )

    @model_validator(mode="after")
    def _goals_for_seek(self) -> MissionConfig:
        if "seek" in self.phases and not self.goals:
            raise ValueError("phase seek needs at least one sentence in mission.goals (or --goal TEXT)")
        return self


class RecordingConfig(BaseModel):
    """Where a run is written down, and by whom."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    directory: str = Field(
        default="recordings",
        min_length=1,
        description="Folder of the recordings, from the working directory; made on use.",
    )
    observers: Mapping[str, Slot] = Field(
        default_factory=dict,
        description="Observers by name, in order: `name: {options}`, with `use` where the plug-in is called "
        "otherwise; `name: false` switches one off.",
    )

    @field_validator("observers", mode="before")
    @classmethod
    def _named_slots(cls, value: Any) -> Any:
        """`rerun: {images: jpeg}` as a slot whose `use` is its name."""
        if not isinstance(value, Mapping):
            return value
        slots: dict[str, Any] = {}
        for name, options in value.items():
            if options is False:
                continue
            if options is None or options is True:
                options = {}
            if not isinstance(options, (Mapping, Slot)):
                raise ValueError(
                    f"{name}: expected its options as a mapping, or false, got {describe(options)}"
                )
            slots[name] = {"use": name, **options} if isinstance(options, Mapping) else options
        return slots


class RunConfig(BaseModel):
    """One run, resolved: every plug-in named."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str = Field(
        default="default",
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$",
        description="Part of the recording's file name: letters, digits, `.`, `_`, `-`.",
    )
    seed: int = Field(
        default=0, strict=True, ge=0, le=2**63 - 1, description="Seeds every generator of the run."
    )
    plugins: tuple[Text, ...] = Field(
        default=(),
        max_length=200,
        description="Files or folders of your own plug-ins, relative to this file.",
    )
    source: Slot = Field(description="Gives frames, takes commands.")
    mission: MissionConfig = Field(default_factory=MissionConfig, description="What the robot does.")
    perception: Slot = Field(description="Frame -> detections.")
    encoder: Slot = Field(description="Text -> unit vectors.")
    llm: Slot = Field(description="Sentences -> target graphs.")
    association: Slot = Field(description="Observations + graph -> changes.")
    update: Slot = Field(description="Windows, dynamics, updates on re-navigation.")
    grounding: Slot = Field(description="Target graph -> ranked viewpoints.")
    navigation: Slot = Field(description="Drives to a viewpoint.")
    diagnosis: tuple[Slot, ...] = Field(
        default=(),
        max_length=100,
        description="Rules that `explain` asks for the layer to blame; none named: all there are.",
    )
    recording: RecordingConfig = Field(
        default_factory=RecordingConfig, description="Where the run is written down."
    )
    on_error: Literal["skip", "fail"] = Field(
        default="skip",
        description="When a plug-in fails on a frame: skip that work and count it, or end the run.",
    )
    timeout_secs: float = Field(
        default=30.0,
        gt=0,
        le=3600,
        description="A plug-in that takes longer ends the run: Python cannot cancel it.",
    )

    _layers: tuple[Layer, ...] = PrivateAttr(())
    _base_dir: Path = PrivateAttr(default_factory=Path.cwd)
    _file: Path | None = PrivateAttr(None)

    @property
    def base_dir(self) -> Path:
        """Where relative paths in plug-in options start: the file's folder, or the working directory."""
        return self._base_dir

    @property
    def file(self) -> Path | None:
        """The YAML file this came from; None for the packaged default."""
        return self._file

    @property
    def slots(self) -> Mapping[str, Slot]:
        """Every slot by its dotted key, observers included."""
        single = {kind: getattr(self, kind) for kind in SLOT_KINDS}
        several = {f"recording.observers.{name}": slot for name, slot in self.recording.observers.items()}
        rules = {f"diagnosis[{index}]": slot for index, slot in enumerate(self.diagnosis)}
        return MappingProxyType(single | several | rules)

    @contextmanager
    def naming_files(self) -> Iterator[None]:
        """Fills in the file of an error that knows only its key: a path, a variable or `--set`."""
        try:
            yield
        except DssmsgError as error:
            if error.file is None and error.key is not None:
                error.file = origin(self._layers, error.key)
            raise

    def with_defaults(self, data: Mapping[str, Any]) -> RunConfig:
        """The same configuration with `data` below everything that it says."""
        config = make_config([Layer("the defaults", data), *self._layers], file=self._file)
        config._base_dir = self._base_dir
        return config

    def resolved(self) -> dict[str, Any]:
        """The configuration as plain values, in the order of the YAML; loads back to an equal one."""
        values = self.model_dump(mode="json")
        for kind in SLOT_KINDS:
            values[kind] = getattr(self, kind).flat()
        written = merge(self._layers).get("recording", {}).get("observers", {})
        values["recording"]["observers"] |= {
            name: False for name, options in written.items() if options is False
        }
        return values

    def resolved_yaml(self) -> str:
        """The configuration as YAML."""
        return dump_yaml(self.resolved())


def kind_of(key: str) -> str:
    """The plug-in kind of a slot's dotted key: `recording.observers.rerun` is an observer."""
    return "observer" if key.startswith("recording.observers.") else key.partition("[")[0]


def packaged_file() -> Path:
    """The canonical `dssmsg.yaml` as it was installed."""
    return Path(str(resources.files("dssmsg") / "data" / LOCAL_FILE))


def find_file(path: Path | None) -> Path | None:
    """The YAML file to use: the given one, else `./dssmsg.yaml`; None where the packaged one has to do."""
    if path is not None:
        return path
    local = Path(LOCAL_FILE)
    return local if local.exists() else None


def load_config(
    path: Path | None = None,
    *,
    sets: Sequence[str] = (),
    sets_label: str = "--set",
    goals: Sequence[str] = (),
    seed: int | None = None,
    environment: Mapping[str, str] | None = None,
) -> RunConfig:
    """The configuration of a run.

    `path` None means `./dssmsg.yaml`, else the packaged file; `environment` None means the process's;
    `sets` are assignments like `perception.use=oracle`, `sets_label` what an error says of where they stand;
    `goals` replace the mission's and add the phase seek
    where it is missing; `seed` replaces the seed. Raises ConfigError naming file and key.
    """
    file = find_file(path)
    layers = file_layers(packaged_file(), label="the packaged dssmsg.yaml")
    if file is not None:
        layers += file_layers(file)
    layers += environment_layers(os.environ if environment is None else environment)
    layers += set_layers(sets, sets_label)
    if seed is not None:
        layers.append(Layer("--seed", {"seed": seed}))
    if goals:
        layers.append(_goal_layer(merge(layers), goals))
    return make_config(layers, file=file)


def _goal_layer(merged: Mapping[str, Any], goals: Sequence[str]) -> Layer:
    mission = merged.get("mission")
    phases = mission.get("phases", ()) if isinstance(mission, Mapping) else ()
    data: dict[str, Any] = {"goals": list(goals)}
    if isinstance(phases, list) and "seek" not in phases:
        data["phases"] = [*phases, "seek"]
    return Layer("--goal", {"mission": data})


def make_config(layers: Sequence[Layer], *, file: Path | None = None) -> RunConfig:
    """The configuration that the layers, lowest first, add up to."""
    try:
        config: RunConfig = validate(RunConfig, merge(layers))
    except DssmsgError as error:
        error.file = origin(layers, error.key) if error.key else None
        if error.file is None and file is not None:
            error.file = str(file)
        raise
    config._layers = tuple(layers)
    config._file = file
    config._base_dir = Path.cwd() if file is None else file.resolve().parent
    return config
