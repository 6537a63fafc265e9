"""`dssmsg report`: a run, or a folder of runs, as one page that needs nothing installed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import ConfigOption, JsonOption
from dssmsg.cli.recordings import chosen, warn_of_cuts

if TYPE_CHECKING:
    from dssmsg.cli.progress import Told
    from dssmsg.recording.reader import Recording

    Explain = Callable[[Recording], Mapping[int, str]]


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def report(
        recording: Annotated[
            Path | None,
            typer.Argument(
                metavar="REC|DIR",
                help="A recording, or a folder of them; else the newest recording.",
                show_default=False,
            ),
        ] = None,
        output: Annotated[
            Path, typer.Option("-o", "--output", metavar="FILE", help="The page to write.")
        ] = Path("report.html"),
        force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
        config: ConfigOption = None,
        as_json: JsonOption = False,
    ) -> None:
        """Write one self-contained HTML page: pictures, map, plots, tables, and why it failed.

        The page needs no network, no script and nothing installed. Why an episode failed is told by the
        rules of your configuration (`diagnosis`), never by what a recording names. Of a folder: how often
        the goal was reached, every episode, and the worst runs in full.

        \b
        Examples:
          dssmsg report
          dssmsg report recordings/run.rrd -o run.html
          dssmsg report sweeps/deltas -o deltas.html
        """
        write_report(recording, output, config, force=force, as_json=as_json)


def write_report(
    place: Path | None, output: Path, config: Path | None, *, force: bool, as_json: bool = False
) -> None:
    """Write the page of a recording or a folder (None: of the newest recording) and print its path."""
    from dssmsg.cli.outfile import check_output, write_output
    from dssmsg.cli.output import print_json, stdout_to_stderr
    from dssmsg.cli.progress import counting

    with stdout_to_stderr(), counting() as progress:
        place = chosen(place)
        check_output(output, place, force=force)
        explain = _explainer(config)
        if place.is_dir():
            page, recordings = _folder_page(place, explain, progress)
        else:
            page, recordings = _recording_page(place, explain), 1
    write_output(page.encode(), output, force=force)
    if as_json:
        print_json({"report": str(output), "recordings": recordings, "bytes": output.stat().st_size})
    else:
        print(output)


def _recording_page(path: Path, explain: Explain) -> str:
    from dssmsg.recording.reader import Recording
    from dssmsg.review.report import report_page

    with Recording.open(path) as opened:
        warn_of_cuts(opened)
        return report_page(opened, explain(opened))


def _folder_page(folder: Path, explain: Explain, progress: Told) -> tuple[str, int]:
    from dssmsg.cli.episodes import index_file
    from dssmsg.errors import InputError
    from dssmsg.review.catalog import find_recordings, read_runs
    from dssmsg.review.report_folder import folder_page

    paths = find_recordings(folder)
    if not paths:
        raise InputError("holds no recording (.rrd); make one with `dssmsg run`", file=folder)
    runs = read_runs(paths, index_file(folder), lambda done, of: progress(done, of, ""))
    return folder_page(folder, runs, explain, progress), len(runs)


def _explainer(config: Path | None) -> Explain:
    """Diagnoses the episodes of a recording by the rules of the local configuration."""
    from dssmsg.cli.plugins import warn_of_failures
    from dssmsg.config import load_config
    from dssmsg.errors import DssmsgError
    from dssmsg.evaluate.diagnosis_rules import RULES, build_rules
    from dssmsg.host import Host
    from dssmsg.review.diagnosis import diagnose, diagnosed_text
    from dssmsg.review.episode import ReviewedRecording

    resolved = load_config(config)
    with resolved.naming_files():
        host = Host.load(resolved.plugins, resolved.base_dir, kinds=RULES)
        rules = build_rules(resolved, host)
    warn_of_failures(host)

    def explain(recording: Recording) -> dict[int, str]:
        told: dict[int, str] = {}
        episodes = recording.told.episodes
        if not episodes:
            return told
        # The original again, by its path: what was repaired is shared.
        with ReviewedRecording.open(recording.path) as opened:
            for one in episodes:
                try:
                    told[one.episode] = diagnosed_text(
                        str(recording.path), diagnose(opened, one.episode, rules)
                    )
                except DssmsgError as error:
                    told[one.episode] = f"cannot be explained: {error.message}"
        return told

    return explain
