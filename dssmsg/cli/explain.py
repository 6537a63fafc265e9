"""`dssmsg explain`: why a recording says what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dssmsg.cli.options import JsonOption
from dssmsg.cli.recordings import RecordingArgument, chosen


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def explain(
        recording: RecordingArgument = None,
        object_id: Annotated[
            str, typer.Option("--object", metavar="ID", help="The life of an object, like object-12.")
        ] = "",
        as_json: JsonOption = False,
    ) -> None:
        """Tell the life of an object: detections, merges with their scores, evidence, verdicts, places."""
        show_explanation(recording, object_id, as_json=as_json)


def show_explanation(recording: Path | None, object_id: str, *, as_json: bool) -> None:
    """Print the life of an object of a recording (a path, or None for the newest)."""
    from dssmsg.cli.output import print_json
    from dssmsg.cli.recordings import warn_of_cuts
    from dssmsg.errors import ConfigError
    from dssmsg.recording.reader import Recording
    from dssmsg.review.life import life_of, life_text

    if not object_id:
        raise ConfigError("say what to explain, like --object object-12", key="--object")
    with Recording.open(chosen(recording)) as opened:
        warn_of_cuts(opened)
        life = life_of(opened, object_id)
    if as_json:
        print_json(life.to_json())
    else:
        print(life_text(life))
