"""`dssmsg episodes`: the episodes of hundreds of recordings, filtered, worst first."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from dssmsg.cli.options import JsonOption


def register(app: typer.Typer) -> None:
    """Add the command to the program."""

    @app.command()
    def episodes(
        directory: Annotated[
            Path | None,
            typer.Argument(
                metavar="DIR",
                help="Folder with recordings, those below it too; else recording.directory.",
                show_default=False,
            ),
        ] = None,
        where: Annotated[
            str, typer.Option("--where", metavar="EXPR", help="Only episodes that this holds for.")
        ] = "",
        worst_by: Annotated[
            str,
            typer.Option(
                "--worst-by", metavar="EXPR", help="Highest first; else failures that took longest."
            ),
        ] = "",
        limit: Annotated[
            int | None, typer.Option("--limit", metavar="N", min=1, help="Print only the N worst.")
        ] = None,
        open_: Annotated[
            int, typer.Option("--open", metavar="N", min=0, max=50, help="Open the N worst in the viewer.")
        ] = 0,
        web: Annotated[bool, typer.Option("--web", help="Open them in the browser.")] = False,
        fresh: Annotated[bool, typer.Option("--fresh", help="Read every file again.")] = False,
        as_json: JsonOption = False,
    ) -> None:
        """List the episodes of many recordings, worst first, and open the worst.

        EXPR compares fields with values: outcome (success, or the reason of the failure), success, goal,
        scene, name, seed, episode, frame, seconds, metres, frames, replans, detours, viewpoints, complete,
        recording, run_id, source, perception, llm, encoder, association, update, grounding, navigation.

        \b
        Examples:
          dssmsg episodes
          dssmsg episodes sweeps/deltas --where "outcome == 'wrong match'" --open 3
          dssmsg episodes --where "not success and scene in ['rs_int'] and seconds > 60"
          dssmsg episodes --where "'sink' in goal" --worst-by "metres / seconds" --json
        """
        list_episodes(
            directory,
            where,
            worst_by=worst_by,
            limit=limit,
            opened=open_,
            web=web,
            fresh=fresh,
            as_json=as_json,
        )


def list_episodes(
    directory: Path | None,
    where: str,
    *,
    worst_by: str,
    limit: int | None,
    opened: int,
    web: bool,
    fresh: bool,
    as_json: bool,
) -> None:
    """Print the rows and open what is asked for. Raises InputError where there is no recording at all."""
    from dssmsg.cli.output import note, print_json, show, stdout_to_stderr
    from dssmsg.cli.progress import counting
    from dssmsg.errors import InputError
    from dssmsg.review.catalog import find_recordings, read_runs
    from dssmsg.review.episodes import chosen_rows, episode_rows, episodes_text

    with stdout_to_stderr(), counting() as progress:
        folder = _folder(directory)
        paths = find_recordings(folder)
        if not paths:
            raise InputError("holds no recording (.rrd); make one with `dssmsg run`", file=folder)
        index = index_file(folder)
        if fresh:
            index.unlink(missing_ok=True)
        runs = read_runs(paths, index, lambda done, of: progress(done, of, ""))
        rows = chosen_rows(episode_rows(runs, folder), where, worst_by)
    for path, entry in runs.items():
        if entry.problem:
            note(f"left out: {path}: {entry.problem}")
        elif not entry.complete:
            note(f"cut off: {path}")
    without = sum(not entry.episodes and not entry.problem for entry in runs.values())
    if without:
        note(f"{without} of {len(runs)} recordings hold no episode")
    if as_json:
        print_json(rows[:limit])
    else:
        show(episodes_text(rows[:limit]))
    if opened and rows:
        _open(folder, rows[:opened], web=web)


def index_file(folder: Path) -> Path:
    """Where what was read of a folder is remembered: in the user's cache, by the folder's path."""
    base = os.environ.get("XDG_CACHE_HOME")
    cache = Path(base) if base else Path.home() / ".cache"
    name = hashlib.sha256(str(folder.resolve()).encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return cache / "dssmsg" / "episodes" / f"{name}.json"


def _folder(directory: Path | None) -> Path:
    from dssmsg.cli.output import note
    from dssmsg.config import load_config
    from dssmsg.errors import InputError

    folder = directory
    if folder is None:
        folder = Path(load_config().recording.directory)
        note(f"reading {folder}")
    if not folder.exists():
        raise InputError("no such folder", file=folder)
    if not folder.is_dir():
        raise InputError("expected a folder with recordings (.rrd)", file=folder)
    return folder


def _open(folder: Path, rows: Sequence[dict[str, Any]], *, web: bool) -> None:
    """Open recordings in one viewer, the first of the rows in front, at the end of its episode."""
    from dssmsg.cli.output import note
    from dssmsg.cli.view import open_viewer
    from dssmsg.recording.viewer import Viewer

    files = list(dict.fromkeys(folder / row["recording"] for row in rows))
    if len(files) == 1:
        open_viewer(files[0], web=web, at=f"frame={rows[0]['frame']}")
        return
    # The last one that is opened is in front.
    files.reverse()
    if web:
        viewer, address = Viewer.serve(files)
        note(f"open {address} (Ctrl-C ends it)")
    else:
        viewer = Viewer.start(files)
    try:
        viewer.wait()
    finally:
        viewer.stop()
