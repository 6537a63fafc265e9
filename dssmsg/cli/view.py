"""`dssmsg view`: a recording in Rerun's viewer, in a window or in the browser."""

from __future__ import annotations

import enum
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssmsg.cli.options import JsonOption
from dssmsg.cli.recordings import AtOption, RecordingArgument, chosen, moment, warn_of_cuts

if TYPE_CHECKING:
    from rerun.blueprint import Blueprint

    from dssmsg.graph.scene_graph import SceneGraph
    from dssmsg.recording.reader import Recording
    from dssmsg.recording.viewer import Viewer


class Layout(enum.StrEnum):
    """What `view` shows: a layout a task."""

    REVIEW = "review"
    SCENE = "scene"
    GRAPH = "graph"
    DYNAMICS = "dynamics"
    LANGUAGE = "language"
    NAVIGATION = "navigation"
    COMPARISON = "comparison"


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def view(
        recording: RecordingArgument = None,
        web: Annotated[
            bool, typer.Option("--web", help="Serve a page for the browser, on this machine.")
        ] = False,
        at: AtOption = None,
        focus: Annotated[
            str | None, typer.Option("--focus", metavar="ID", help="Look at a node, like object-12.")
        ] = None,
        layout: Annotated[
            Layout | None,
            typer.Option("--layout", help="What to show; else what the recording was made to show."),
        ] = None,
        as_json: JsonOption = False,
    ) -> None:
        """Open a recording in the viewer.

        --focus looks at a node from nearby, with a bright box round it and its life told beside; without
        --at it opens at the last time that a window judged the object. A page (--web) is served to this
        machine alone; Ctrl-C ends it. What `dssmsg diff --recording` wrote is shown in the layout comparison.
        --json says what is shown and where, once it is open.

        \b
        Examples:
          dssmsg view
          dssmsg view recordings/run.rrd --at frame=120 --layout navigation
          dssmsg view --focus object-12 --layout dynamics
          dssmsg view --web --at time=24.5
        """
        open_viewer(
            chosen(recording),
            web=web,
            at=at,
            focus=focus,
            layout=layout and layout.value,
            as_json=as_json,
        )


def open_viewer(
    path: Path,
    *,
    web: bool = False,
    at: str | None = None,
    focus: str | None = None,
    layout: str | None = None,
    as_json: bool = False,
) -> None:
    """Show a recording and wait until the window is closed.

    Raises InputError if the recording does not read, ConfigError for an unknown node or time, and ViewerError
    where no window can be opened.
    """
    from dssmsg.errors import ConfigError
    from dssmsg.recording.blueprint import eye_on, make_layout
    from dssmsg.recording.focus import save_focus
    from dssmsg.recording.newest import is_comparison
    from dssmsg.recording.reader import Recording
    from dssmsg.recording.viewer import Viewer

    if is_comparison(path):
        _open_comparison(path, web=web, at=at, focus=focus, layout=layout, as_json=as_json)
        return
    if layout == Layout.COMPARISON:
        raise ConfigError(
            f"{path} is one run; two side by side are made by `dssmsg diff A B --recording OUT.rrd`",
            key="--layout",
        )
    with Recording.open(path) as opened, tempfile.TemporaryDirectory(prefix="dssmsg-") as folder:
        frame, update = moment(opened, at)
        warn_of_cuts(opened)
        when = "at that time"
        if at is None and focus is not None:
            frame = _judged(opened, focus)
            when = "at the end of the run" if frame is None else f"at frame {frame}"
        graph = opened.graph_at(frame, update=update)
        if update is not None:
            frame = opened.frame_of_update(update)
        named = layout or _own_layout(opened)
        shown = make_layout(named, eye_on(graph, focus, when), focused=focus is not None)
        additions = []
        if focus is not None:
            additions.append(Path(folder) / "focus.rrd")
            save_focus(additions[0], opened.facts["run_id"], graph, focus, _page(opened, graph, focus))
        page = None
        if frame is None:
            frame = max(opened.frame_indices, default=0)
        if web:
            viewer, page = _serve(opened.readable_path, shown, additions, frame)
        else:
            viewer = Viewer.start([opened.readable_path, *additions])
        try:
            if not web:
                viewer.show(shown, frame)
            _say_open(path, named, frame, focus, page, as_json=as_json)
            viewer.wait()
        finally:
            viewer.stop()


def _say_open(
    path: Path, layout: str, frame: int | None, focus: str | None, page: str | None, *, as_json: bool
) -> None:
    """The address of a page for the human; with `--json` what is open, at once, as the viewer stays."""
    import sys

    from dssmsg.cli.output import note, print_json

    if page is not None:
        note(f"open {page} (Ctrl-C ends it)")
    if as_json:
        print_json({"recording": str(path), "layout": layout, "frame": frame, "focus": focus, "page": page})
        sys.stdout.flush()


def _open_comparison(
    path: Path, *, web: bool, at: str | None, focus: str | None, layout: str | None, as_json: bool
) -> None:
    """Show two runs side by side, as the file itself says. Raises ConfigError for what only one run has."""
    from dssmsg.errors import ConfigError
    from dssmsg.recording.comparison import last_frame
    from dssmsg.recording.viewer import Viewer

    if layout not in (None, Layout.COMPARISON.value):
        raise ConfigError(f"{path} compares two runs; it has the layout comparison alone", key="--layout")
    if focus is not None:
        raise ConfigError(f"{path} compares two runs; look at a node in one of them", key="--focus")
    frame = (at or "").removeprefix("frame=")
    if frame and not (frame.isdecimal() and len(frame) < 10):
        raise ConfigError(f"expected frame=N for two runs side by side, got {at!r}", key="--at")
    page = None
    if web:
        viewer, page = Viewer.serve([path])
    else:
        viewer = Viewer.start([path])
    shown = None if web else int(frame) if frame else last_frame(path)
    try:
        if shown is not None:
            viewer.show(frame=shown)
        _say_open(path, Layout.COMPARISON.value, shown, None, page, as_json=as_json)
        viewer.wait()
    finally:
        viewer.stop()


def _serve(recording: Path, layout: Blueprint, additions: list[Path], frame: int) -> tuple[Viewer, str]:
    """A page that opens at a frame, and its address; where that cannot be, one that opens at the end."""
    from dssmsg.cli.output import note
    from dssmsg.recording import schema
    from dssmsg.recording.viewer import Viewer, ViewerError

    with tempfile.TemporaryDirectory(prefix="dssmsg-") as folder:
        layout_file = Path(folder) / "layout.rbl"
        layout.save(schema.APPLICATION_ID, str(layout_file))
        try:
            return Viewer.serve_at(recording, frame, layout_file, additions)
        except ViewerError as error:
            note(f"the page opens at the end, in the recording's own layout: {error.message}")
            return Viewer.serve([recording, *additions])


def _own_layout(recording: Recording) -> str:
    """The layout that the run was told to have; `review` for one that this program does not know."""
    named = recording.facts.get("layout")
    return named if named in list(Layout) else Layout.REVIEW.value


def _judged(recording: Recording, node: str) -> int | None:
    """The frame of the last verdict on an object, else of the last evidence; None: the end."""
    frame = None
    decided = False
    for row in recording.windows():
        verdict = node in row["verdicts"]
        evidence = any(one["object"] == node and one["frame"] == row["frame"] for one in row["evidence"])
        if verdict or (evidence and not decided):
            frame, decided = row["frame"], decided or verdict
    return frame


def _page(recording: Recording, graph: SceneGraph, node: str) -> str:
    """What there is to say on a node, as Markdown."""
    from dssmsg.errors import InputError
    from dssmsg.review.life import life_of, life_text

    try:
        told = life_text(life_of(recording, node))
    except InputError:  # no object: a waypoint, a viewpoint
        ends = [edge for edge in graph.edges.values() if node in (edge.source, edge.target)]
        told = "\n".join(f"{edge.source} -{edge.kind}- {edge.target}" for edge in ends[:40])
    lines = [f"- {line.strip()}" for line in told.splitlines() if line.strip()]
    return "\n".join([f"## {node}", "", *lines]) + "\n"
