"""What a sweep is to run: a YAML file that names configurations, scenes and seeds, as a list of runs."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from dssmsg.config import RunConfig, find_file, load_config
from dssmsg.config_errors import validate
from dssmsg.config_layers import ENV_PREFIX
from dssmsg.config_yaml import read_yaml
from dssmsg.errors import ConfigError
from dssmsg.evaluate.missions import fingerprint
from dssmsg.host import Host
from dssmsg.slot_problems import problems_of_slot

MAX_RUNS = 100_000
_NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"

LoadHost = Callable[[Sequence[str], Path], Host]
Seed = Annotated[int, Field(strict=True, ge=0, le=2**63 - 1)]


class Matrix(BaseModel):
    """The file of a sweep. Options stand as in a configuration, or dotted (`association.use: dovsg`)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(default="", pattern=rf"^$|{_NAME}", description="Of the sweep; else the file's name.")
    config: str | None = Field(
        default=None, description="Base configuration, from this file's folder; else ./dssmsg.yaml."
    )
    set: Mapping[str, Any] = Field(default_factory=dict, description="Options of every run.")
    configurations: Mapping[Annotated[str, Field(pattern=_NAME)], Mapping[str, Any] | None] = Field(
        default_factory=lambda: {"default": None}, min_length=1, description="Options of each, by its name."
    )
    scenes: tuple[str, ...] = Field(
        default=(), max_length=10_000, description="Values of source.scene; none: the configuration's own."
    )
    seeds: Annotated[int, Field(strict=True, ge=1, le=MAX_RUNS)] | tuple[Seed, ...] = Field(
        default=1, description="How many, from 0; or a list of seeds."
    )


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a sweep, as any process of any machine can carry it out.

    `folder` (absolute) is its own; `cwd` is where relative paths of `sets` begin; `label` is what errors say
    of where these stand; `environment` holds the variables that belong to the configuration, and no others.
    """

    configuration: str
    scene: str
    seed: int
    folder: Path
    cwd: Path
    config: Path | None
    sets: tuple[str, ...]
    label: str
    environment: Mapping[str, str]

    @property
    def name(self) -> str:
        """For people: `loose, rs_int, seed 3`."""
        return ", ".join(part for part in (self.configuration, self.scene, f"seed {self.seed}") if part)

    def load(self, load_host: LoadHost = Host.load) -> tuple[RunConfig, Host]:
        """The run's configuration, recording into its folder, and the plug-ins. Raises ConfigError."""
        config = load_config(
            self.config, sets=self.sets, sets_label=self.label, seed=self.seed, environment=self.environment
        )
        with config.naming_files():
            host = load_host(config.plugins, config.base_dir)
        recorded = config.recording.model_copy(update={"directory": str(self.folder)})
        return config.model_copy(update={"recording": recorded}), host


def read_matrix(file: Path) -> Matrix:
    """The matrix of a file. Raises ConfigError naming file and key."""
    matrix: Matrix = validate(Matrix, read_yaml(file), file=str(file))
    if matrix.model_fields_set.isdisjoint(("configurations", "scenes", "seeds")):
        raise ConfigError("says nothing to sweep; expected configurations, scenes or seeds", file=file)
    if not matrix.name:
        stem = re.sub(r"[^A-Za-z0-9._-]", "_", file.stem).lstrip("._-")[:64]
        matrix = matrix.model_copy(update={"name": stem or "sweep"})
    return matrix


def plan_runs(matrix: Matrix, file: Path, work: Path, load_host: LoadHost = Host.load) -> list[Run]:
    """Every run of a matrix, seed by seed, so that a sweep that is cut early has all configurations.

    Each configuration and scene is checked before anything is run. Raises ConfigError naming the matrix' key.
    """
    seeds = range(matrix.seeds) if isinstance(matrix.seeds, int) else tuple(dict.fromkeys(matrix.seeds))
    scenes: tuple[str, ...] = tuple(dict.fromkeys(matrix.scenes)) or ("",)
    count = len(seeds) * len(scenes) * len(matrix.configurations)
    if not 0 < count <= MAX_RUNS:
        raise ConfigError(f"asks for {count} runs; expected 1 to {MAX_RUNS:,}", file=file)
    base = find_file(None) if matrix.config is None else file.parent / Path(matrix.config).expanduser()
    base = None if base is None else base.resolve()
    common = _sets(matrix.set)
    variables = {name: value for name, value in os.environ.items() if name.startswith(ENV_PREFIX)}
    load_host = lru_cache(load_host)  # runs with the same plug-ins share their host
    runs = []
    for seed in seeds:
        for scene in scenes:
            for name, options in matrix.configurations.items():
                own = [f"source.scene={json.dumps(scene)}"] if scene else []
                sets = (*common, *_sets(options or {}), *own)
                place = (work / "runs").resolve()
                label = f"{file}, configuration {name}"
                run = Run(name, scene, seed, place, Path.cwd(), base, sets, label, variables)
                runs.append(_placed(run, load_host, asks_source=seed == seeds[0]))
    return runs


def _placed(run: Run, load_host: LoadHost, *, asks_source: bool) -> Run:
    """The run with a folder that its resolved configuration names. Raises ConfigError if that is wrong.

    `asks_source`: look at the scene too, which reads files and is the same for all seeds. Models and keys are
    left to the runs, which may be carried out elsewhere.
    """
    try:
        config, host = run.load(load_host)
        with config.naming_files():
            host.check(config)
        if asks_source:
            for problem in problems_of_slot(host, "source", config.source, "source", config.base_dir, None):
                key, _, message = problem.partition(": ")
                raise ConfigError(message, key=key)
    except ConfigError as error:
        place = run.label if error.file in (None, run.label) else f"{run.label} ({error.file})"
        raise ConfigError(error.message, file=place, key=error.key) from error
    readable = re.sub(r"[^A-Za-z0-9._-]+", "_", f"{run.configuration}-{run.scene}-{run.seed}")[-120:]
    folder = run.folder / f"{readable}-{fingerprint(config, host)}"
    return replace(run, folder=folder)


def _sets(options: Mapping[str, Any]) -> tuple[str, ...]:
    """Options as `--set` takes them; JSON is one-line YAML."""
    return tuple(f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in options.items())
