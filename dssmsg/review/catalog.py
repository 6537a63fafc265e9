"""What many recordings say of themselves and their episodes, read quickly and remembered.

A file that was read before, and is as it was (size, time of change, inode), is not read again. Of a finished
one just the entities that tell it are read; one that was cut off is opened as a whole. A file that is no
recording is named and left out.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dssmsg.errors import DssmsgError
from dssmsg.events import EpisodeEnded
from dssmsg.recording import schema
from dssmsg.recording.chunk_index import chunks_alone
from dssmsg.recording.columns import component_of
from dssmsg.recording.damage import json_value
from dssmsg.recording.footer import Footer
from dssmsg.recording.messages import MessagePicker
from dssmsg.recording.reader import Recording
from dssmsg.recording.repair import check_recording
from dssmsg.recording.told import episode

INDEX_VERSION = 1
_MOST_THREADS = 8

Json = dict[str, Any]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class RunEntry:
    """One file. `facts` are the run's (name, seed, scene, plugins by slot ...), `episodes` as recorded.

    `problem` says why a file could not be read at all, `complete` is False for a run that was cut off.
    """

    facts: Mapping[str, Any]
    episodes: tuple[Mapping[str, Any], ...]
    complete: bool = True
    problem: str = ""


def find_recordings(folder: Path) -> list[Path]:
    """All `.rrd` files below a folder, sorted; hidden ones left out."""
    return sorted(
        path
        for path in folder.rglob("*.rrd")
        if not any(part.startswith(".") for part in path.relative_to(folder).parts) and path.is_file()
    )


def read_runs(
    paths: Sequence[Path], index: Path | None = None, progress: Progress = lambda _done, _of: None
) -> dict[Path, RunEntry]:
    """Every file's entry. `index` is a file to remember them in; a damaged or old one counts for nothing."""
    stamps = {path: _stamp(path) for path in paths}
    known = _load(index)
    found: dict[Path, RunEntry] = {}
    for path in paths:
        kept = known.get(str(path.resolve()))
        if kept is not None and kept[0] == stamps[path]:
            found[path] = kept[1]
    missing = [path for path in paths if path not in found]
    progress(len(found), len(paths))
    pool = ThreadPoolExecutor(min(_MOST_THREADS, os.cpu_count() or 1))  # Rerun reads without Python's lock
    try:
        for path, entry in zip(missing, pool.map(_quick_entry, missing), strict=True):
            found[path] = entry or _entry(path)
            progress(len(found), len(paths))
    finally:
        pool.shutdown(cancel_futures=True)
    if missing and index is not None:
        # A file that is still growing has no index of its own yet: it is read again.
        _store(index, {str(p.resolve()): (stamps[p], found[p]) for p in paths if found[p].complete})
    return {path: found[path] for path in paths}


def _stamp(path: Path) -> list[int]:
    """What changes when a file does."""
    try:
        state = path.stat()
    except OSError:
        return []
    return [state.st_size, state.st_mtime_ns, state.st_ino]


def _entry(path: Path) -> RunEntry:
    """The entry of a file, read by itself; a cut one from a repaired copy."""
    try:
        with Recording.open(path) as recording:
            episodes = tuple(map(_plain, recording.told.episodes))
            return RunEntry(_facts(recording.facts), episodes, recording.complete)
    except DssmsgError as error:
        return RunEntry({}, (), problem=error.message)
    except (KeyError, TypeError, AttributeError) as error:
        return RunEntry({}, (), problem=f"the run's facts: damaged ({error})")


def _plain(episode: EpisodeEnded) -> Json:
    """An episode as JSON values."""
    return {**asdict(episode), "values": dict(episode.values)}


def _facts(facts: Mapping[str, Any]) -> Json:
    """The facts that rows are made of."""
    source = facts.get("source", {})
    return {
        "run_id": str(facts["run_id"]),
        "name": str(facts["name"]),
        "seed": facts["seed"],
        "source": str(source.get("name", "")),
        "scene": str(source.get("scene", "")),
        "plugins": {str(slot): str(made.get("name", "")) for slot, made in facts["plugins"].items()},
    }


def _quick_entry(path: Path) -> RunEntry | None:
    """The entry of a finished recording of this schema, by the few chunks that tell it.

    None for whatever is not plain: the reader says it best.
    """
    run, summary = (f"/__properties/{name}" for name in (schema.RUN_PROPERTY, schema.SUMMARY_PROPERTY))
    episodes, column = schema.EPISODES.path, schema.EPISODES.component("json")
    try:
        check_recording(path)
        footer = Footer.of(path)
        if footer is None or footer.application_id != schema.APPLICATION_ID:
            return None
        spans = [span for entity in (episodes, run, summary) for span in footer.spans.get(entity, ())]
        cells: dict[tuple[str, str | None], list[Any]] = {}
        for chunk in chunks_alone(MessagePicker(path, footer.first), spans):
            batch = chunk.to_record_batch()
            for field, values in zip(batch.schema, batch.columns, strict=True):
                name = component_of(field)
                if name in ("json", "schema_version", column):
                    cells.setdefault((chunk.entity_path, name), []).extend(values.to_pylist())
        if cells[run, "schema_version"][-1] != [schema.SCHEMA_VERSION] or not cells[summary, "json"][-1]:
            return None
        told = [_plain(episode(json_value(cell[0]))) for cell in cells.get((episodes, column), ())]
        facts = _facts(json_value(cells[run, "json"][-1][0]))
    except (DssmsgError, OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError):
        return None
    return RunEntry(facts, tuple(sorted(told, key=lambda one: int(one["episode"]))))


def _load(index: Path | None) -> dict[str, tuple[list[int], RunEntry]]:
    if index is None:
        return {}
    try:
        stored = json.loads(index.read_text("utf-8"))
        if stored["version"] != [INDEX_VERSION, schema.SCHEMA_VERSION]:
            return {}
        return {path: (stamp, RunEntry(**entry)) for path, (stamp, entry) in stored["files"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _store(index: Path, files: Mapping[str, tuple[list[int], RunEntry]]) -> None:
    """Whole or not at all; a folder that cannot be written to means only that files are read again."""
    value = {
        "version": [INDEX_VERSION, schema.SCHEMA_VERSION],
        "files": {path: [stamp, asdict(entry)] for path, (stamp, entry) in files.items()},
    }
    with suppress(OSError):
        index.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=index.parent, prefix=f".{index.name}-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(value, file)
            Path(name).replace(index)
        finally:
            Path(name).unlink(missing_ok=True)
