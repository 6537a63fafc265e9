"""`dssmsg eval table4`: sentences answered with viewpoints, method by method."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dssmsg.cli.options import ConfigOption, JsonOption, ScenesOption, SetOption


def register(group: typer.Typer) -> None:
    """Add the command to the group `eval`."""

    @group.command()
    def table4(
        methods: Annotated[
            str,
            typer.Option(
                metavar="A,B",
                help="Of dssm, dssm_paper, image, objects, objects_core, configured (what `grounding` says).",
            ),
        ] = "dssm,dssm_paper,image,objects",
        scenes: ScenesOption = "rs_int,ihlen_1_int",
        perception: Annotated[str, typer.Option(metavar="A,B", help="Perception plug-ins.")] = "furniture",
        seeds: Annotated[int, typer.Option(min=1, max=1000, help="Runs of each.")] = 1,
        seed: Annotated[int, typer.Option(min=0, help="Seed of the first run; the others count up.")] = 0,
        when: Annotated[
            str, typer.Option(metavar="A,B", help="static: after the survey; changed: after the revisit.")
        ] = "static,changed",
        generated: Annotated[
            int, typer.Option(min=0, max=5000, help="Sentences to make of each scene's truth besides.")
        ] = 0,
        failures: Annotated[
            bool,
            typer.Option("--failures", help="Tell on stderr what `dssm` got wrong, and how it was read."),
        ] = False,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: Annotated[
            Path | None,
            typer.Option(metavar="FOLDER", help="Keep recordings here, and use those that are there."),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Table IV: sentences answered with ranked viewpoints, recall at 1, 2 and 3.

        All methods on the same recorded graphs; chance beside them. Without --work nothing is kept.

        \b
        Examples:
          dssmsg eval table4
          dssmsg eval table4 --json
        """
        show_table4(
            _names(methods, "--methods"), _names(scenes, "--scenes"), _names(perception, "--perception"),
            range(seed, seed + seeds), _states(when), generated, config, sets or (), work,
            failures=failures, as_json=as_json,
        )  # fmt: skip


def show_table4(
    methods: Sequence[str],
    scenes: Sequence[str],
    perceptions: Sequence[str],
    seeds: Sequence[int],
    when: Sequence[str],
    generated: int,
    config: Path | None,
    sets: Sequence[str],
    work: Path | None,
    *,
    failures: bool,
    as_json: bool,
) -> None:
    """Print the rows of `evaluate_table4`, as JSON or as a table; progress goes to stderr."""
    from dssmsg.cli.evaluate import work_folder
    from dssmsg.cli.output import note, print_json, stdout_to_stderr

    with stdout_to_stderr(), work_folder(work) as folder:
        from dssmsg.evaluate.table4 import evaluate_table4, table4_rows

        answers = evaluate_table4(
            folder, scenes=scenes, perceptions=perceptions, methods=methods, seeds=seeds, when=when,
            generated=generated, config=config, sets=sets, progress=_progress,
        )  # fmt: skip
        rows = table4_rows(answers)
    for one in answers:
        if failures and one.method == "dssm" and one.rank != 1:
            asked = f"{one.scene} {one.perception} {one.when} {one.query.set}: {one.query.text!r}"
            wanted = ", ".join(one.query.targets)
            note(f"{asked}: rank {one.rank} ({wanted})\n    read as {one.parse}\n    {one.said}")
    if as_json:
        print_json(rows)
    else:
        print(rows_text(rows))


def rows_text(rows: Sequence[dict[str, Any]]) -> str:
    """One line a scene, perception, question and method, with R@1, R@2 and R@3 side by side."""
    lines: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in rows:
        question, _, rank = row["metric"].rpartition("_")
        key = (row["scene"], row["perception"], question, row["method"])
        lines.setdefault(key, {"n": row["n"]})[rank] = f"{row['mean']:.3f}"
    cells = [("scene", "perception", "question", "method", "R@1", "R@2", "R@3", "n")]
    cells += [(*key, line["R@1"], line["R@2"], line["R@3"], str(line["n"])) for key, line in lines.items()]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )


def _names(text: str, option: str) -> list[str]:
    from dssmsg.cli.evaluate import names_of

    return names_of(text, option)


def _states(text: str) -> list[str]:
    states = _names(text, "--when")
    if not set(states) <= {"static", "changed"}:
        raise typer.BadParameter(f"expected static or changed, got '{text}'", param_hint="--when")
    return states


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
