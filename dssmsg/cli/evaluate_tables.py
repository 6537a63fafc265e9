"""`dssmsg eval table1`, `table2`, `table3`, `fig5`, `occlusion`, `identity`: methods on homes that change."""

from __future__ import annotations

import enum
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import ConfigOption, JsonOption, ScenesOption, SetOption

if TYPE_CHECKING:
    from dssmsg.evaluate.replays import Case, Setup
    from dssmsg.evaluate.tables import Row

HELP = {
    "table1": "Table I: static and dynamic objects of the map, precision, recall and F1.\n\nA dynamic object"
    " counts only with the right state; dynamic_split counts a move as disappear + appear.",
    "table2": "Table II: the states of dynamic objects, F1 of each.\n\nAppeared, disappeared, relocated.",
    "table3": "Table III: update on re-navigation.\n\nUpdate success, static retention, accuracy gain.",
    "fig5": "Figure 5: relative accuracy after each valid update.\n\nHomes that changed by less than 0.02 are"
    " left out and counted.",
    "identity": "Two things of one kind that are swapped, and things that are put back.\n\nThree visits.",
}
"""What each command says of itself; the first line stands in the list of commands."""


class Perception(enum.StrEnum):
    """What the methods are given."""

    ORACLE = "oracle"
    FURNITURE = "furniture"


MethodsOption = Annotated[
    str,
    typer.Option(metavar="A,B", help="Of dssm, dssm_paper_exact, conceptgraphs, dovsg, none."),
]
SeedsOption = Annotated[int, typer.Option(min=1, max=1000, help="Homes of each scene, seeds from 0.")]
PerceptionOption = Annotated[Perception, typer.Option(help="Whose detections all methods are given.")]
JobsOption = Annotated[int, typer.Option(min=1, max=64, help="Homes worked on at a time.")]
WorkOption = Annotated[
    Path | None,
    typer.Option(metavar="FOLDER", help="Keep recordings, scores, CSV and PNG here; go on where it stopped."),
]
FigureOption = Annotated[bool, typer.Option("--figure/--no-figure", help="Draw a PNG into --work.")]
METHODS = "dssm,dssm_paper_exact,conceptgraphs,dovsg,none"
SCENES = "rs_int,ihlen_1_int"
IDENTITY = {"swap": 1, "put_back": 1}


@dataclass(frozen=True, slots=True)
class _Request:
    """What all these commands are asked."""

    methods: str
    scenes: str
    perception: str
    jobs: int
    config: Path | None
    sets: tuple[str, ...]
    work: Path | None
    figure: bool
    as_json: bool


def register(group: typer.Typer) -> None:
    """Add the commands to the group `eval`."""
    for table, text in HELP.items():
        _add(group, table, text)

    @group.command()
    def occlusion(
        cases: Annotated[int, typer.Option(min=1, max=10_000, help="Cases in all.")] = 100,
        methods: MethodsOption = "dssm",
        scenes: ScenesOption = SCENES,
        perception: PerceptionOption = Perception.ORACLE,
        jobs: JobsOption = 1,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: WorkOption = None,
        figure: FigureOption = False,
        as_json: JsonOption = False,
    ) -> None:
        """Things that are still there but cannot be seen: is any called disappeared?

        A screen is put before a thing between two visits of one stop.

        \b
        Examples:
          dssmsg eval occlusion --work runs
          dssmsg eval occlusion --json
        """
        request = _Request(
            methods, scenes, perception.value, jobs, config, tuple(sets or ()), work, figure, as_json
        )
        _show("occlusion", request, cases)


def _add(group: typer.Typer, table: str, text: str) -> None:
    example = f"dssmsg eval {table} --seeds 10 --jobs 2 --work runs"

    @group.command(table, help=f"{text}\n\n\b\nExample:\n  {example}")
    def command(
        methods: MethodsOption = METHODS,
        scenes: ScenesOption = SCENES,
        seeds: SeedsOption = 10,
        perception: PerceptionOption = Perception.ORACLE,
        jobs: JobsOption = 1,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: WorkOption = None,
        figure: FigureOption = False,
        as_json: JsonOption = False,
    ) -> None:
        request = _Request(
            methods, scenes, perception.value, jobs, config, tuple(sets or ()), work, figure, as_json
        )
        _show(table, request, seeds)


def _show(table: str, request: _Request, number: int) -> None:
    """Print the rows of a table; progress and the files that were written go to stderr."""
    from dssmsg.cli.evaluate import names_of, work_folder
    from dssmsg.cli.output import note, print_json, stdout_to_stderr

    methods, scenes = names_of(request.methods, "--methods"), names_of(request.scenes, "--scenes")
    with stdout_to_stderr(), work_folder(request.work) as folder:
        from dssmsg.evaluate.replays import Setup, methods_named, replay_cases
        from dssmsg.evaluate.tables import table_rows, write_rows

        wanted = methods_named(methods)
        setup = Setup(folder, request.config, request.sets)
        cases = _cases(table, setup, scenes, request.perception, number)
        scores = replay_cases(setup, cases, wanted, jobs=request.jobs, progress=_progress)
        rows = table_rows(table, scores)
        if request.work is not None:
            files = write_rows(rows, folder, f"{table}-{request.perception}")
            if request.figure:
                from dssmsg.evaluate.tables_figure import draw_figure

                files.append(folder / f"{table}-{request.perception}.png")
                draw_figure(table, rows, files[-1])
            note(f"wrote {', '.join(map(str, files))}")
    if request.as_json:
        print_json(rows)
    else:
        print(rows_text(rows))


def _cases(table: str, setup: Setup, scenes: Sequence[str], perception: str, number: int) -> list[Case]:
    from dssmsg.evaluate.replays import Case
    from dssmsg.sim.scenario import USUAL

    if table == "occlusion":
        from dssmsg.evaluate.replays_occlusion import occlusion_cases

        return occlusion_cases(setup.work, scenes, number, perception, progress=_progress)
    counts: Mapping[str, int] = IDENTITY if table == "identity" else USUAL
    visits = 3 if table == "identity" else 2
    # Seed by seed, so that an evaluation that is cut early has every scene.
    return [Case(scene, seed, perception, counts, visits) for seed in range(number) for scene in scenes]


def rows_text(rows: Sequence[Row]) -> str:
    """Rows as a table for a reader, the paper's figure beside where it has one."""
    columns = ("scene", "method", "perception", "metric", "mean", "std", "n", "paper")
    cells = [columns, *(tuple(_cell(row.get(name)) for name in columns) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
