"""`dssmsg eval diagnosis`: known faults put into episodes; does `explain` name the right layer?"""

from __future__ import annotations

import enum
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer

from dssmsg.cli.options import ConfigOption, JsonOption, SetOption


class Half(enum.StrEnum):
    """Which seeds: rules are developed on the even ones, figures are those of the odd ones."""

    DEVELOPMENT = "development"
    REPORTED = "reported"
    BOTH = "both"


def register(group: typer.Typer) -> None:
    """Add the command to the group `eval`."""

    @group.command()
    def diagnosis(
        episodes: Annotated[int, typer.Option(min=1, max=2000, help="Episodes with a fault.")] = 120,
        healthy: Annotated[int, typer.Option(min=0, max=2000, help="Episodes without one.")] = 30,
        half: Annotated[
            Half, typer.Option(help="Even seeds are for development, odd ones are reported.")
        ] = Half.BOTH,
        failures: Annotated[bool, typer.Option("--failures", help="Tell on stderr what was wrong.")] = False,
        jobs: Annotated[int, typer.Option(min=1, max=64, help="Episodes made at a time.")] = 1,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: Annotated[
            Path | None,
            typer.Option(metavar="FOLDER", help="Keep episodes here, and use those that are there."),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Episodes with one known fault each: does `explain` name the right layer, with truth and without?

        An episode counts if it succeeds without the fault and fails with it. Prints the confusion of layers
        on stderr, and rows of layer_accuracy, wrong and cannot_tell. Without --work nothing is kept.

        \b
        Examples:
          dssmsg eval diagnosis --work runs
          dssmsg eval diagnosis --json
        """
        show_diagnosis(
            episodes, healthy, half.value, config, sets or (), work, jobs, failures=failures, as_json=as_json
        )


def show_diagnosis(
    episodes: int,
    healthy: int,
    half: str,
    config: Path | None,
    sets: Sequence[str],
    work: Path | None,
    jobs: int,
    *,
    failures: bool,
    as_json: bool,
) -> None:
    """Print the rows of `evaluate_diagnosis`; progress and the confusion tables go to stderr."""
    from dssmsg.cli.evaluate import print_rows, work_folder
    from dssmsg.cli.output import note, stdout_to_stderr

    with stdout_to_stderr(), work_folder(work) as folder:
        from dssmsg.evaluate.diagnosis import confusion, diagnosis_rows, evaluate_diagnosis
        from dssmsg.evaluate.diagnosis_cases import chosen_seeds

        done = evaluate_diagnosis(
            folder, seeds=chosen_seeds(episodes, half), healthy=healthy, config=config, sets=sets, jobs=jobs,
            progress=_progress,
        )  # fmt: skip
    for one in done:
        right = "no fault" if one.true == "healthy" else one.true
        if failures and one.said != right:
            basis = "with truth" if one.with_truth else "without truth"
            note(f"seed {one.seed}, {one.fault}, {basis}: {one.said}, not {right}")
            if one.rule:
                note(f"    {one.rule} ({one.confidence:.2f}) from frame {one.frame}: {one.summary}")
    for with_truth in (True, False):
        note(f"said {'with' if with_truth else 'without'} truth, by true layer")
        note(confusion_text(confusion(done, with_truth=with_truth)))
    print_rows(diagnosis_rows(done), as_json=as_json)


def confusion_text(table: Mapping[str, Mapping[str, int]]) -> str:
    """Rows: the true layer; columns: what was said."""
    from dssmsg.interfaces.diagnosis import LAYERS
    from dssmsg.review.diagnosis import CANNOT_TELL, NO_FAULT

    said = [*LAYERS, CANNOT_TELL, NO_FAULT]
    rows = [("", *said)]
    rows += [
        (true, *(str(table[true].get(name, "")) for name in said))
        for true in (*LAYERS, "healthy")
        if true in table
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
