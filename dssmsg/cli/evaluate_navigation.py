"""`dssmsg eval navigation`: episodes of language navigation in changing homes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from dssmsg.cli.options import ConfigOption, JsonOption, SetOption


def register(group: typer.Typer) -> None:
    """Add the command to the group `eval`."""

    @group.command()
    def navigation(
        episodes: Annotated[int, typer.Option(min=1, max=10000, help="Episodes in all.")] = 100,
        scenes: Annotated[
            str, typer.Option(metavar="A,B", help="Scenes, by name; `generated` for generated homes.")
        ] = "rs_int,ihlen_1_int,generated",
        perception: Annotated[str, typer.Option(metavar="NAME", help="Perception plug-in.")] = "furniture",
        seed: Annotated[int, typer.Option(min=0, help="Seed of the first surveys.")] = 0,
        per_survey: Annotated[int, typer.Option(min=1, max=100, help="Episodes from one survey.")] = 5,
        homes: Annotated[int, typer.Option(min=1, max=1000, help="How many generated homes.")] = 3,
        obstacles: Annotated[
            int, typer.Option(min=0, max=20, help="Things that appear on the way in one survey's episodes.")
        ] = 3,
        record: Annotated[bool, typer.Option("--record", help="Keep a recording of every run.")] = False,
        failures: Annotated[bool, typer.Option("--failures", help="Tell on stderr what went wrong.")] = False,
        jobs: Annotated[int, typer.Option(min=1, max=64, help="Surveys worked on at a time.")] = 1,
        config: ConfigOption = None,
        sets: SetOption = None,
        work: Annotated[
            Path | None,
            typer.Option(metavar="FOLDER", help="Keep finished episodes here, and use those that are there."),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Goals in words, driven to in homes that change: success, SPL, re-plans, failure reasons.

        Judged by the simulator's truth: within 1 m of a viewpoint that shows an answer, and it is in view.
        Without --work nothing is kept.

        \b
        Examples:
          dssmsg eval navigation --episodes 30 --perception oracle --work runs
          dssmsg eval navigation --episodes 5 --json
        """
        show_navigation(
            _names(scenes), homes, perception, episodes, seed, per_survey, obstacles, config, sets or (),
            work, jobs, record=record, failures=failures, as_json=as_json,
        )  # fmt: skip


def show_navigation(
    scenes: Sequence[str],
    homes: int,
    perception: str,
    episodes: int,
    seed: int,
    per_survey: int,
    obstacles: int,
    config: Path | None,
    sets: Sequence[str],
    work: Path | None,
    jobs: int,
    *,
    record: bool,
    failures: bool,
    as_json: bool,
) -> None:
    """Print the rows of `evaluate_navigation`; progress goes to stderr."""
    from dssmsg.cli.evaluate import print_rows, work_folder
    from dssmsg.cli.output import note, stdout_to_stderr

    with stdout_to_stderr(), work_folder(work) as folder:
        from dssmsg.evaluate.navigation import evaluate_navigation, navigation_rows, scene_list

        done = evaluate_navigation(
            folder, scenes=scene_list(scenes, homes), perception=perception, episodes=episodes,
            per_survey=per_survey, obstacles=obstacles, seed=seed, config=config, sets=sets,
            record=record, jobs=jobs, progress=_progress,
        )  # fmt: skip
    for one in done:
        if failures and one.judged.outcome != "success":
            said = one.judged.reason or one.judged.outcome
            note(f"{one.scene}, seed {one.seed}: {one.judged.goal!r}: {said}; ended at {one.judged.end}")
    print_rows(navigation_rows(done), as_json=as_json)


def _names(text: str) -> list[str]:
    from dssmsg.cli.evaluate import names_of

    return names_of(text, "--scenes")


def _progress(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
