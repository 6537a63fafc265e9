"""The configuration of a replay: the recording's own, what the user changes on top, and what is reused.

A recording is a stranger's file. Of its configuration names and numbers are taken; it never says what code
is imported (`plugins:`, `use: file.py:Class`, `use: module:Class`), which server is asked (`llm`) or what is
written where (`recording`): those come from the user's file and `--set` alone.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dssmsg.config import SLOT_KINDS, MissionConfig, RunConfig, make_config, packaged_file
from dssmsg.config_layers import Layer, environment_layers, file_layers, origin, set_layers
from dssmsg.config_yaml import describe
from dssmsg.errors import ConfigError, DssmsgError, InputError
from dssmsg.host import Host
from dssmsg.recording.reader import Recording

NAME_LENGTH = 64
_WORTH_A_PROCESS = 400
"""Frames from which the start of another process, two seconds of work, is well spent."""
_TAKEN = (
    "name",
    "seed",
    "mission",
    "perception",
    "encoder",
    "association",
    "update",
    "grounding",
    "navigation",
    "on_error",
    "timeout_secs",
)
"""What of a recorded configuration is used again."""
_KEY_FRAMES = ("views_per_heading", "heading_step_deg")
"""Options of the mission that decide which frames perception runs on."""


@dataclass(frozen=True, slots=True)
class ReplayPlan:
    """What a replay runs: the whole configuration, the host for it, and what of the recording is reused."""

    config: RunConfig
    host: Host
    reuses_detections: bool
    reuses_answers: bool
    changed: Mapping[str, tuple[Any, Any]]
    """Dotted key -> (recorded value, value now), for every value that the user changed."""
    left_out: tuple[str, ...]
    """Dotted keys of recorded options that this version does not know."""


def plan_replay(
    recording: Recording,
    *,
    file: Path | None = None,
    sets: Sequence[str] = (),
    environment: Mapping[str, str] | None = None,
    processes: bool = False,
) -> ReplayPlan:
    """Put a replay together and check every slot of it; nothing is written yet.

    `file` is a YAML file of the user's (`./dssmsg.yaml` is not read), `environment` None the process's.
    `processes`: the recording is written by a process of its own, unless the user said whether to.
    Raises ConfigError where a value is wrong, cannot change in a replay, or names code out of the recording;
    InputError where the recording holds no configuration.
    """
    label = f"the configuration in {recording.path}"
    assignments = set_layers(sets)
    _refuse_fixed(assignments)
    own = file_layers(file) if file is not None else []
    own += environment_layers(os.environ if environment is None else environment)
    own += assignments
    packaged = file_layers(packaged_file(), label="the packaged dssmsg.yaml")
    recorded, left_out = _known(recorded_layer(recording, label), packaged, own, file)
    base = [*packaged, recorded]
    before, asked = make_config(base), make_config([*base, *own], file=file)
    reuses_detections = recording.has_detections and all(
        _same(before, asked, key) for key in ("perception", "encoder", "seed", *_KEY_FRAMES)
    )
    reuses_answers = not any("llm" in layer.data for layer in own)
    top = _top_layer(recording, before, asked, reuses_detections, reuses_answers)
    if processes:
        _write_apart(top, asked)
    layers = [*base, *own, top]
    config = make_config(layers, file=file)
    _refuse_recorded_code(config, layers, label)
    host = _host(config)
    try:
        host.check(config)
    except DssmsgError as error:
        named = error.file == label and str(error.key).endswith(".use")
        if named and recording.config.get("plugins"):
            error.message += (
                "; plug-in files of a recording are never loaded: name yours by --config or --set"
            )
        raise
    changed = _changes(before.resolved(), asked.resolved())
    return ReplayPlan(config, host, reuses_detections, reuses_answers, changed, left_out)


def _host(config: RunConfig) -> Host:
    with config.naming_files():
        return Host.load(config.plugins, config.base_dir)


def _known(
    recorded: Layer, packaged: Sequence[Layer], own: Sequence[Layer], file: Path | None
) -> tuple[Layer, tuple[str, ...]]:
    """A recorded layer without the options that this version has no more, and the keys of these."""
    mission = recorded.data.get("mission")
    rest = {key: value for key, value in recorded.data.items() if key != "mission"}
    host = _host(make_config([*packaged, Layer(recorded.label, rest), *own], file=file))
    models = {(one.kind, one.name): one.config for one in host.registrations()}
    known: dict[str, Mapping[str, Any]] = {}
    if isinstance(mission, Mapping):
        known["mission"] = MissionConfig.model_fields
    for kind in SLOT_KINDS:
        slot = recorded.data.get(kind)
        if isinstance(slot, Mapping) and (kind, slot.get("use")) in models:
            known[kind] = {"use": None, **models[kind, str(slot["use"])].model_fields}
    left_out = [
        f"{part}.{name}"
        for part, fields in known.items()
        for name in recorded.data[part]
        if name not in fields
    ]
    data = {
        part: {name: one for name, one in value.items() if name in known[part]} if part in known else value
        for part, value in recorded.data.items()
    }
    return Layer(recorded.label, data), tuple(left_out)


def recorded_layer(recording: Recording, label: str) -> Layer:
    """What of a recording's configuration is used again, as a layer. InputError where it holds none."""
    recorded = recording.facts.get("config")
    if not isinstance(recorded, Mapping):
        raise InputError(f"holds no configuration, but {describe(recorded)}", file=recording.path)
    return Layer(label, {key: recorded[key] for key in _TAKEN if key in recorded})


def worth_processes(recording: Recording) -> bool:
    """Whether there is a core for other processes, and enough to do for them."""
    return len(recording.readable_frame_indices) >= _WORTH_A_PROCESS and (os.cpu_count() or 1) >= 2


def _write_apart(top: Layer, asked: RunConfig) -> None:
    rerun = asked.recording.observers.get("rerun")
    if rerun is not None and "process" not in rerun.options and "recording" in top.data:
        top.data["recording"]["observers"]["rerun"]["process"] = True


def recorded_slot(path: Path, use: str = "recorded", **options: Any) -> dict[str, Any]:
    """A slot that reads from a recording: `source`, `perception` and `llm` have a plug-in that does."""
    return {"use": use, "recording": str(path.resolve()), **options}


def _top_layer(
    recording: Recording, before: RunConfig, asked: RunConfig, detections: bool, answers: bool
) -> Layer:
    """What a replay decides itself, above everything else."""
    path = recording.path
    name = asked.name
    if name == before.name:
        name = name.removesuffix("-replay")[: NAME_LENGTH - len("-replay")] + "-replay"
    top: dict[str, Any] = {
        "name": name,
        "source": recorded_slot(path, "recording"),
        "mission": {"phases": list(before.mission.phases), "goals": list(before.mission.goals)},
    }
    if detections:
        top["perception"] = recorded_slot(path)
    if answers:
        # The lexicon is offline and asks nobody: it stands in for what was not asked then.
        top["llm"] = recorded_slot(path, fallback={"use": "lexicon"})
    # Images are copied as they are: decoding and encoding would take longer than everything else.
    images = recording.facts.get("images")
    rerun = asked.recording.observers.get("rerun")
    if images in ("jpeg", "lossless") and rerun is not None and rerun.use == "rerun":
        top["recording"] = {"observers": {"rerun": {"images": images, "copy_images": str(path.resolve())}}}
    return Layer("the replay", top)


def _refuse_fixed(assignments: Sequence[Layer]) -> None:
    """What was recorded cannot be recorded otherwise."""
    for layer in assignments:
        if "source" in layer.data:
            raise ConfigError(
                "a replay takes its frames from the recording; `dssmsg run` drives anew",
                file=layer.label,
                key="source",
            )
        mission = layer.data.get("mission")
        for key in ("phases", "goals"):
            if isinstance(mission, Mapping) and key in mission:
                hint = "; `dssmsg query REC TEXT` grounds other sentences" if key == "goals" else ""
                raise ConfigError(
                    f"a replay has the {key} of the recording{hint}", file=layer.label, key=f"mission.{key}"
                )


def _same(before: RunConfig, asked: RunConfig, key: str) -> bool:
    if key in _KEY_FRAMES:
        return bool(getattr(before.mission, key) == getattr(asked.mission, key))
    return bool(before.resolved()[key] == asked.resolved()[key])


def _refuse_recorded_code(config: RunConfig, layers: Sequence[Layer], label: str) -> None:
    """Raise ConfigError where a slot names a file or module, and it is the recording that says so."""
    for key, use in _uses(config.resolved(), ""):
        if ":" in use and origin(layers, key) == label:
            raise ConfigError(
                f"the recording names the code {use!r}, which is never imported from there; name one of "
                f"yours by --config FILE or --set {key}=...",
                file=label,
                key=key,
            )


def _uses(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """Every `use` in nested values, with its dotted key."""
    items: Sequence[tuple[str, Any]] = []
    if isinstance(value, Mapping):
        items = [(f"{key}.{name}" if key else str(name), one) for name, one in value.items()]
    elif isinstance(value, list | tuple):
        items = [(f"{key}[{index}]", one) for index, one in enumerate(value)]
    for place, one in items:
        if place.rpartition(".")[2] == "use" and isinstance(one, str):
            yield place, one
        else:
            yield from _uses(one, place)


def _changes(before: Any, after: Any, key: str = "") -> dict[str, tuple[Any, Any]]:
    """Where two resolved configurations differ, but for `plugins` and `recording`, which no replay shares."""
    if key in ("plugins", "recording"):
        return {}
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        found: dict[str, tuple[Any, Any]] = {}
        for name in dict.fromkeys([*before, *after]):
            found |= _changes(before.get(name), after.get(name), f"{key}.{name}" if key else name)
        return found
    return {} if json.dumps(before, default=str) == json.dumps(after, default=str) else {key: (before, after)}
