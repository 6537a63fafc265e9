"""Commands that read recordings: `inspect`, `export`; and which recording, and when, a command is about."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import JsonOption

if TYPE_CHECKING:
    from dssmsg.recording.reader import Recording


class Format(enum.StrEnum):
    """What `export` writes."""

    JSON = "json"
    GRAPHML = "graphml"
    SPARK_DSG = "spark-dsg"
    PLY = "ply"


RecordingArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="REC", help="A recording; else the newest under recording.directory.", show_default=False
    ),
]
AtOption = Annotated[
    str | None,
    typer.Option("--at", metavar="TIME", help="frame=120, time=24.5 or update=300; else the end."),
]


def register(app: typer.Typer) -> None:
    """Add the commands to the program."""

    @app.command()
    def inspect(
        recording: RecordingArgument = None,
        as_json: JsonOption = False,
    ) -> None:
        """Say what happened in a run: phases, changes, episodes, errors, timings.

        \b
        Examples:
          dssmsg inspect
          dssmsg inspect recordings/run.rrd --json
        """
        from dssmsg.cli.output import print_json, show
        from dssmsg.recording.reader import Recording
        from dssmsg.review.summary import summarize
        from dssmsg.review.text import summary_text

        with Recording.open(chosen(recording)) as opened:
            summary = summarize(opened)
            if as_json:
                print_json(summary)
            else:
                show(summary_text(summary, opened.errors()))

    @app.command()
    def export(
        recording: RecordingArgument = None,
        at: AtOption = None,
        format: Annotated[Format, typer.Option("--format", help="Of the file.")] = Format.JSON,
        output: Annotated[
            Path | None,
            typer.Option("-o", "--output", metavar="FILE", help="Else standard output.", show_default=False),
        ] = None,
        force: Annotated[bool, typer.Option("--force", help="Overwrite FILE.")] = False,
    ) -> None:
        """Write the scene graph of a recording, at any time of the run, to a file.

        \b
        Examples:
          dssmsg export --format graphml -o graph.graphml
          dssmsg export recordings/run.rrd --at frame=120 --format ply -o map.ply
        """
        from dssmsg.cli.outfile import check_output, write_output
        from dssmsg.graph.export import export_graph
        from dssmsg.recording.reader import Recording

        path = chosen(recording)
        check_output(output, path, force=force)
        with Recording.open(path) as opened:
            frame, update = moment(opened, at)
            warn_of_cuts(opened)
            data = export_graph(opened.graph_at(frame, update=update), format.value)
        write_output(data, output, force=force)


def chosen(recording: Path | None) -> Path:
    """The recording that a command is about; says which one where none was named.

    Raises InputError if there is none, ConfigError if the configuration does not say where to look.
    """
    if recording is not None:
        return recording
    from dssmsg.cli.output import note
    from dssmsg.config import load_config
    from dssmsg.recording.newest import newest

    path = newest(Path(load_config().recording.directory))
    note(f"reading {path}")
    return path


def moment(recording: Recording, at: str | None) -> tuple[int | None, int | None]:
    """`--at` as (frame, update), at most one of them set; neither: the end.

    Raises ConfigError if it is malformed, or the run has no such time.
    """
    from dssmsg.errors import ConfigError

    if at is None:
        return None, None
    name, _, value = at.partition("=") if "=" in at else ("frame", "", at)
    try:
        if name == "frame":
            return _within(recording, int(value)), None
        if name == "time":
            return recording.frame_at_time(float(value)), None
        if name == "update":
            return None, _among_updates(recording, int(value))
    except ValueError:
        pass
    raise ConfigError(f"expected frame=N, time=SECONDS or update=N, got {at!r}", key="--at")


def _within(recording: Recording, frame: int) -> int:
    from dssmsg.errors import ConfigError

    indices = recording.frame_indices
    if not indices or not indices[0] <= frame <= indices[-1]:
        span = f"its frames are {indices[0]} to {indices[-1]}" if indices else "it has no frames"
        raise ConfigError(f"no frame {frame} in {recording.path}: {span}", key="--at")
    return frame


def _among_updates(recording: Recording, update: int) -> int:
    from dssmsg.errors import ConfigError

    if not 0 <= update <= recording.changes_recorded:
        raise ConfigError(
            f"no update {update} in {recording.path}: its updates are 1 to {recording.changes_recorded}"
            " (0: before all)",
            key="--at",
        )
    return update


def warn_of_cuts(recording: Recording) -> None:
    """Say on stderr what a recording that was cut off lacks."""
    from dssmsg.cli.output import note

    for line in recording.cut_notes():
        note(f"warning: {recording.path}: {line}")
