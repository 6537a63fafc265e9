"""Rows of the tables as the events they were told as: the inverse of `dssmsg.recording.rows`.

What a mission told (`dssmsg.events`) comes back as the same typed, frozen value, whatever version of the
schema it was stored in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from dssmsg import events
from dssmsg.graph.verdicts import Evidence
from dssmsg.recording import schema
from dssmsg.recording.damage import json_value, reading
from dssmsg.recording.migrations import Migrations
from dssmsg.recording.store import ChunkFile

Json = dict[str, Any]
T = TypeVar("T")


class Told:
    """What else happened, besides frames and changes of the graph, in the order of telling.

    Everything is read on first use, a table at a time. The sim times of phases, log lines and timings are
    those of the timeline, to the nanosecond. Raises InputError, naming file and row, where a row is
    damaged.
    """

    def __init__(self, file: ChunkFile, path: Path, migrations: Migrations) -> None:
        self._file = file
        self._path = path
        self._migrations = migrations

    @cached_property
    def phases(self) -> Sequence[events.PhaseStarted]:
        """Phases begun."""
        table = self._file.table(schema.PHASES)
        with reading(self._path, "the phases"):
            return [
                events.PhaseStarted(_text(phase), _whole(visit), _whole(index), seconds)
                for phase, visit, index, seconds in zip(
                    *(table.values(name) for name in ("phase", "visit", "index")),
                    self._times(schema.PHASES),
                    strict=True,
                )
            ]

    @cached_property
    def windows(self) -> Sequence[events.WindowEvaluated]:
        """Evaluations of viewpoints' windows, evidence and verdicts with them."""
        return self._rows(schema.WINDOWS, window)

    def windows_about(self, ids: Collection[str]) -> Iterator[events.WindowEvaluated]:
        """Those windows that have evidence of, or a verdict on, one of these objects; no other is decoded."""
        for number, row in self._json(schema.WINDOWS, ids):
            with reading(self._path, f"row {number} of {schema.WINDOWS.path}"):
                yield window(row)

    @cached_property
    def matches(self) -> Sequence[events.Matched]:
        """Grounded queries with all candidates, best first."""
        return self._rows(schema.MATCHES, match)

    @cached_property
    def llm_calls(self) -> Sequence[events.LlmCalled]:
        """LLM calls, failed ones too."""
        return self._rows(schema.LLM_CALLS, llm_call)

    @cached_property
    def navigation(self) -> Sequence[events.NavigationChanged]:
        """Changes of the driver's state."""
        return self._rows(schema.NAVIGATION, navigation)

    @cached_property
    def episodes(self) -> Sequence[events.EpisodeEnded]:
        """Episodes ended."""
        return self._rows(schema.EPISODES, episode)

    @cached_property
    def errors(self) -> Sequence[events.ErrorOccurred]:
        """Failures."""
        return self._rows(schema.ERRORS, error)

    @cached_property
    def logs(self) -> Sequence[events.Logged]:
        """Log lines."""
        table = self._file.table(schema.LOGS)
        with reading(self._path, "the log lines"):
            return [
                events.Logged(frame, seconds, _text(logger), _text(level), _text(message))
                for frame, seconds, logger, level, message in zip(
                    table.frames,
                    self._times(schema.LOGS),
                    *(table.values(name) for name in ("logger", "level", "message")),
                    strict=True,
                )
            ]

    @cached_property
    def timings(self) -> Sequence[events.StageTimed]:
        """Wall seconds by stage, a row a frame."""
        table = self._file.table(schema.TIMINGS)
        with reading(self._path, "the timings"):
            return [
                events.StageTimed(frame, seconds, dict(zip(stages, values, strict=True)))
                for frame, seconds, stages, values in zip(
                    table.frames,
                    self._times(schema.TIMINGS),
                    table.cells("stage"),
                    table.cells("seconds"),
                    strict=True,
                )
            ]

    def json(self, table: schema.Table, about: Collection[str] | None = None) -> list[Json]:
        """The JSON values of a table's rows, brought up to the present schema.

        `about`: only of rows that have one of these texts, in quotes, somewhere; no other is decoded.
        """
        return [row for _, row in self._json(table, about)]

    def _json(self, table: schema.Table, about: Collection[str] | None) -> Iterator[tuple[int, Json]]:
        """Rows with their numbers, from 1."""
        quoted = None if about is None else [f'"{name}"' for name in about]
        for number, text in enumerate(self._file.table(table).stream("json"), 1):
            with reading(self._path, f"row {number} of {table.path}"):
                if quoted is not None and not any(name in text for name in quoted):
                    continue
                row = self._migrations.row(table, _object(text))
            yield number, row

    def texts(self, table: schema.Table) -> Iterator[str]:
        """The JSON of a table's rows as it is stored: to tell equal rows without reading them."""
        return ("" if text is None else str(text) for text in self._file.table(table).stream("json"))

    def _rows(self, table: schema.Table, make: Callable[[Json], T]) -> list[T]:
        found = []
        for number, row in enumerate(self.json(table), 1):
            with reading(self._path, f"row {number} of {table.path}"):
                found.append(make(row))
        return found

    def _times(self, table: schema.Table) -> Sequence[float]:
        return self._file.table(table).sim_times


def window(row: Json) -> events.WindowEvaluated:
    """A row of `/windows`. Like the others, raises ValueError, KeyError or TypeError if it is malformed."""
    return events.WindowEvaluated(
        viewpoint_id=_text(row["viewpoint"]),
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        base=tuple(map(_whole, row["base"])),
        comparison=tuple(map(_whole, row["comparison"])),
        evidence=tuple(
            Evidence(
                frame=_whole(one["frame"]),
                object_id=_text(one["object"]),
                verdict=one["verdict"],
                values=_reals(one["values"]),
            )
            for one in row["evidence"]
        ),
        verdicts={_text(name): _text(verdict) for name, verdict in row["verdicts"].items()},
        threshold=_whole(row["threshold"]),
    )


def match(row: Json) -> events.Matched:
    """A row of `/match`."""
    return events.Matched(
        query=_text(row["query"]),
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        target=dict(row["target"]),
        candidates=tuple(
            events.Candidate(
                viewpoint_id=_text(one["viewpoint"]),
                rank=_whole(one["rank"]),
                scores=_reals(one["scores"]),
                matching={_text(name): _text(found) for name, found in one["matching"].items()},
                reason=_text(one["reason"]),
            )
            for one in row["candidates"]
        ),
    )


def llm_call(row: Json) -> events.LlmCalled:
    """A row of `/llm`."""
    tokens = row["tokens"]
    texts = ("role", "provider", "prompt", "answer", "request_hash", "error", "fallback_for")
    return events.LlmCalled(
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        ok=bool(row["ok"]),
        tokens=None if tokens is None else _whole(tokens),
        seconds=_real(row["seconds"]),
        attempt=_whole(row["attempt"]),
        **{name: _text(row[name]) for name in texts},
    )


def navigation(row: Json) -> events.NavigationChanged:
    """A row of `/nav/events`."""
    target = row["target_xy"]
    return events.NavigationChanged(
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        state=_text(row["state"]),
        detail=_text(row["detail"]),
        path=tuple(map(_text, row["path"])),
        target_xy=None if target is None else (_real(target[0]), _real(target[1])),
    )


def episode(row: Json) -> events.EpisodeEnded:
    """A row of `/episodes`."""
    return events.EpisodeEnded(
        episode=_whole(row["episode"]),
        goal=_text(row["goal"]),
        outcome=_text(row["outcome"]),
        reason=_text(row["reason"]),
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        values=dict(row["values"]),
    )


def error(row: Json) -> events.ErrorOccurred:
    """A row of `/errors`."""
    return events.ErrorOccurred(
        frame=_whole(row["frame"]),
        sim_time=_real(row["sim_time"]),
        plugin=_text(row["plugin"]),
        message=_text(row["message"]),
        skipped=_text(row["skipped"]),
        fatal=bool(row["fatal"]),
    )


def _object(text: str) -> Json:
    row = json_value(text)
    if not isinstance(row, dict):
        raise ValueError(f"expected a JSON object, got {type(row).__name__}")
    return row


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"expected text, got {value!r}")
    return value


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"expected a whole number, got {value!r}")
    return value


def _real(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"expected a finite number, got {value!r}")
    return float(value)


def _reals(values: Mapping[str, Any]) -> dict[str, float]:
    return {_text(name): _real(value) for name, value in values.items()}
