"""`dssmsg sweep`: many configurations x scenes x seeds, one table at the end."""

from __future__ import annotations

import enum
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import JsonOption

if TYPE_CHECKING:
    from dssmsg.evaluate.sweep_engines import Engine as EngineFunction


class Engine(enum.StrEnum):
    """Where the runs are carried out."""

    LOCAL = "local"
    RAY = "ray"


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def sweep(
        matrix: Annotated[
            Path, typer.Argument(metavar="MATRIX", help="YAML file: configurations, scenes, seeds.")
        ],
        work: Annotated[
            Path | None,
            typer.Option(
                "--work",
                metavar="FOLDER",
                help="Recordings and results; else sweeps/NAME.",
                show_default=False,
            ),
        ] = None,
        jobs: Annotated[
            int | None,
            typer.Option("--jobs", metavar="N", min=1, max=1024, help="Runs at a time; else one a core."),
        ] = None,
        engine: Annotated[
            Engine, typer.Option("--engine", help="Processes of this machine, or a Ray cluster.")
        ] = Engine.LOCAL,
        address: Annotated[
            str | None,
            typer.Option(
                "--address", metavar="HOST:PORT", help="A running Ray cluster; else one is started."
            ),
        ] = None,
        csv: Annotated[bool, typer.Option("--csv", help="Print the table as CSV.")] = False,
        as_json: JsonOption = False,
    ) -> None:
        """Run many configurations, scenes and seeds, and print one table.

        What is done stays in the work folder: a sweep that was cut off goes on where it stopped, and the
        same command prints the same table again. Exit code 1 if a run failed; it is repeated next time.

        \b
        Examples:
          dssmsg sweep matrix.yaml
          dssmsg sweep matrix.yaml --jobs 2 --work /data/sweep --json
          dssmsg sweep matrix.yaml --engine ray --address 127.0.0.1:6379
        """
        raise typer.Exit(run_sweep(matrix, work, jobs, engine, address, as_csv=csv, as_json=as_json))


def run_sweep(
    file: Path,
    work: Path | None,
    jobs: int | None,
    engine: Engine,
    address: str | None,
    *,
    as_csv: bool,
    as_json: bool,
) -> int:
    """Carry out a sweep, print its table and return the exit code."""
    from dssmsg.cli.output import note, print_json, show, stdout_to_stderr
    from dssmsg.cli.plugins import warn_of_failures
    from dssmsg.cli.progress import counting
    from dssmsg.errors import ConfigError

    if as_csv and as_json:
        raise ConfigError("give one of --csv and --json", key="--csv")
    if address is not None and engine is not Engine.RAY:
        raise ConfigError("needs --engine ray", key="--address")
    with stdout_to_stderr(), counting() as progress:
        from dssmsg.evaluate import sweep_engines
        from dssmsg.evaluate.sweep import rows_csv, run_rows, sweep, sweep_rows, sweep_text
        from dssmsg.evaluate.sweep_matrix import plan_runs, read_matrix
        from dssmsg.host import Host

        matrix = read_matrix(file)
        place = work or Path("sweeps") / matrix.name
        hosts: list[Host] = []

        def load_host(paths: Sequence[str], base_dir: Path) -> Host:
            hosts.append(Host.load(paths, base_dir))
            return hosts[-1]

        runs = plan_runs(matrix, file, place, load_host)
        warn_of_failures(*hosts)
        at_once = jobs or _cores()
        note(f"sweep in {place}: {len(runs)} run{'s' * (len(runs) > 1)}, up to {at_once} at a time")
        carry_out: EngineFunction = sweep_engines.local
        if engine is Engine.RAY:
            carry_out = partial(sweep_engines.ray, address=address)
        results = sweep(runs, carry_out, jobs=at_once, progress=progress)
        rows = sweep_rows(results)
        (place / "runs.csv").write_text(rows_csv(run_rows(results, place)), "utf-8")
    if as_json:
        print_json(rows)
    elif as_csv:
        print(rows_csv(rows), end="")
    else:
        show(sweep_text(rows))
        note(f"a line a run, with its recording: {place / 'runs.csv'}")
    failed = [result for result in results if result.error]
    for result in failed:
        name = ", ".join(part for part in (result.configuration, result.scene, f"seed {result.seed}") if part)
        note(f"failed: {name}: {result.error}")
    return 1 if failed else 0


def _cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
