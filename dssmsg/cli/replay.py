"""`dssmsg replay`: recorded frames through other plug-ins."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import JsonOption
from dssmsg.cli.recordings import RecordingArgument, chosen

if TYPE_CHECKING:
    from dssmsg.mission.ahead import Ahead
    from dssmsg.mission.run import RunResult
    from dssmsg.recording.reader import Recording


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def replay(
        recording: RecordingArgument = None,
        sets: Annotated[
            list[str] | None,
            typer.Option(
                "--set",
                metavar="KEY=VALUE",
                help="Change one value of the recorded configuration; repeatable.",
            ),
        ] = None,
        config: Annotated[
            Path | None,
            typer.Option(
                "--config",
                metavar="FILE",
                help="YAML file laid over the recorded configuration.",
                show_default=False,
            ),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Send recorded frames through other plug-ins and leave a recording that names its parent.

        Open loop: the robot does what it did, and what navigation asks for now is noted as advice. Recorded
        detections and answers of a language model are used again as long as nothing that makes them changes.

        Examples:

        dssmsg replay --set association.delta_sim=1.2

        dssmsg replay run.rrd --set perception.use=oracle --json

        dssmsg replay run.rrd --set plugins=[my_detector.py] --set perception.use=my-detector
        """
        raise typer.Exit(replay_command(recording, sets or [], config, as_json=as_json))


def replay_command(recording: Path | None, sets: list[str], file: Path | None, *, as_json: bool) -> int:
    """Replay a recording (a path, or None for the newest), print the summary, and return the exit code."""
    from dssmsg.cli.output import print_json, show, stdout_to_stderr
    from dssmsg.cli.recordings import warn_of_cuts
    from dssmsg.mission.ahead import Ahead
    from dssmsg.mission.replay_config import worth_processes
    from dssmsg.recording.reader import Recording
    from dssmsg.review.text import summary_text

    with stdout_to_stderr(), Recording.open(chosen(recording)) as opened:
        warn_of_cuts(opened)
        # Started before anything is put together, so that it is ready when the first frame is asked for.
        with Ahead() if worth_processes(opened) else nullcontext() as ahead:
            result = _replay(opened, sets, file, ahead)
    if as_json:
        print_json(result.summary)
    else:
        show(summary_text(result.summary))
        if result.summary["faster"]:
            print(f"{'replayed':<11}{result.summary['faster']} times as fast as the recorded run")
    return result.exit_code


def _replay(recording: Recording, sets: list[str], file: Path | None, ahead: Ahead | None) -> RunResult:
    """Put a replay together, say how it differs from the run, and carry it out."""
    from dssmsg.cli.output import note
    from dssmsg.cli.plugins import warn_of_failures
    from dssmsg.mission.replay import replay_mission
    from dssmsg.mission.replay_config import plan_replay

    plan = plan_replay(recording, file=file, sets=sets, processes=ahead is not None)
    warn_of_failures(plan.host)
    for key in plan.left_out:
        note(f"warning: {key} is left out: this version has no such option")
    for key, (before, now) in plan.changed.items():
        note(f"{key}: {before} -> {now}")
    reused = [
        what
        for what, is_reused in (
            ("detections", plan.reuses_detections),
            ("answers of the language model", plan.reuses_answers),
        )
        if is_reused
    ]
    note(f"recorded {' and '.join(reused) or 'frames alone'} used again")
    config = plan.config
    if any(one.name == "progress" for one in plan.host.registrations("observer")):
        config = config.with_defaults({"recording": {"observers": {"progress": {}}}})
    return replay_mission(config, plan.host, recording, ahead=ahead)
