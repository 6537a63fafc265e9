"""`dssmsg diff`: what swapping a plug-in changed, in results and in cause."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dssmsg.cli.options import JsonOption


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def diff(
        a: Annotated[Path, typer.Argument(metavar="A", help="A recording.", show_default=False)],
        b: Annotated[Path, typer.Argument(metavar="B", help="Another one.", show_default=False)],
        recording: Annotated[
            Path | None,
            typer.Option(
                "--recording",
                metavar="OUT.rrd",
                help="Also write both graphs side by side, for the viewer.",
                show_default=False,
            ),
        ] = None,
        force: Annotated[bool, typer.Option("--force", help="Overwrite OUT.rrd.")] = False,
        view: Annotated[bool, typer.Option("--view", help="Open both side by side in the viewer.")] = False,
        as_json: JsonOption = False,
    ) -> None:
        """Tell what differs between two runs: settings, where they part and why, objects, matches, cost.

        Examples:

        dssmsg diff run.rrd run-replay.rrd

        dssmsg diff a.rrd b.rrd --recording both.rrd
        """
        diff_command(a, b, recording, force=force, view=view, as_json=as_json)


def diff_command(
    a: Path, b: Path, output: Path | None, *, force: bool = False, view: bool, as_json: bool
) -> None:
    """Compare two recordings, print the difference, and show both side by side where that is asked for."""
    import tempfile

    from dssmsg.cli.outfile import check_output, write_output
    from dssmsg.cli.output import note, print_json, show
    from dssmsg.cli.recordings import warn_of_cuts
    from dssmsg.recording.reader import Recording
    from dssmsg.review.diff import compare
    from dssmsg.review.diff_text import difference_text

    check_output(output, a, b, force=force, key="--recording")
    with (
        Recording.open(a) as first,
        Recording.open(b) as second,
        tempfile.TemporaryDirectory(prefix="dssmsg-") as folder,
    ):
        for opened in (first, second):
            warn_of_cuts(opened)
        difference = compare(first, second)
        if output is not None or view:
            from dssmsg.review.diff_picture import write_picture

            place = Path(folder) / ("both.rrd" if output is None else output.name)
            write_picture(place, first, second, difference)
            if output is not None:
                write_output(place.read_bytes(), output, force=force)
                note(f"both side by side: {output}")
        if as_json:
            print_json(difference.to_json())
        else:
            show(difference_text(difference))
        if view:
            from dssmsg.recording.viewer import Viewer

            viewer = Viewer.start([place])
            try:
                viewer.wait()
            finally:
                viewer.stop()
