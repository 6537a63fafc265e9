"""Missions made once for an evaluation and kept: the recording of a scene, perception and seed."""

from __future__ import annotations

import hashlib
import json
import shutil
from importlib import metadata
from pathlib import Path

from dssmsg.config import RunConfig
from dssmsg.errors import ConfigError
from dssmsg.host import Host
from dssmsg.mission.run import run_mission

_ASKED = ("grounding", "navigation")
"""Slots that come into play only once somebody asks for something."""


def recorded_mission(work: Path, name: str, config: RunConfig, host: Host) -> tuple[Path, bool]:
    """The recording of a mission, and whether it had to be made now.

    It is recognised by its resolved configuration and this package's version, not by the code: use a new
    folder after changing that. Raises ConfigError where no observer records.
    """
    if "rerun" not in {slot.use for slot in config.recording.observers.values()}:
        raise ConfigError("needs the observer rerun: answers are found in the recording", key="recording")
    folder = work / f"{name}-{fingerprint(config, host)}"
    done = folder / "done.json"
    if done.is_file():
        return folder / json.loads(done.read_text("utf-8"))["recording"], False
    if folder.exists():  # what a run that was cut left behind
        shutil.rmtree(folder)
    folder.mkdir(parents=True)
    recorded = config.recording.model_copy(update={"directory": str(folder)})
    placed = config.model_copy(update={"recording": recorded})
    with placed.naming_files():
        recording = Path(run_mission(placed, host).summary["recording"])
    draft = done.with_suffix(".tmp")
    draft.write_text(json.dumps({"recording": recording.name}), "utf-8")
    draft.replace(done)  # whole or not at all: it is what marks the run as done
    return folder / recording.name, True


def fingerprint(config: RunConfig, host: Host) -> str:
    """What a recording depends on, but for the code: the resolved configuration and this package's version.

    Where the mission seeks nothing, grounding and navigation have no part in it.
    """
    left_out = {"recording", *(() if "seek" in config.mission.phases else _ASKED)}
    resolved = {key: value for key, value in host.resolved(config).items() if key not in left_out}
    text = json.dumps([metadata.version("dssmsg"), resolved], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:10]
