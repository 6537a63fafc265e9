"""How events get from the mission into a recording: by a thread of its own, through a bounded queue.

The mission waits while the queue is full, and nothing is dropped. What is written is flushed every so often,
whether or not anything was told: after `kill -9` the file lacks at most what was told since the last flush,
and what waited in the queue. `writer_process` does the same in another process.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from dssmsg.events import ErrorOccurred, Event, RunFinished

if TYPE_CHECKING:
    from dssmsg.recording.writer import RecordingWriter


@dataclass(frozen=True, slots=True)
class Settings:
    """What a writer is made with, see `RecordingWriter`; `flush_secs` wall seconds between two flushes, and
    `queue_size` events that may wait."""

    path: Path
    run_id: str
    images: Literal["jpeg", "lossless"]
    quality: int
    layout: str
    copied: Path | None
    flush_secs: float
    queue_size: int

    def writer(self) -> RecordingWriter:
        """Create the file. Raises StorageError where it exists or cannot be created."""
        from dssmsg.recording.writer import RecordingWriter

        return RecordingWriter(
            self.path,
            self.run_id,
            images=self.images,
            quality=self.quality,
            layout=self.layout,
            copied=self.copied,
        )


class Writing(Protocol):
    """The mission's side of a writer. Every method raises what stopped the writer, if anything did."""

    def tell(self, event: Event) -> None:
        """Hand an event over; when a run is over, wait until it is in the file."""
        ...

    def close(self) -> None:
        """Write what is waiting and close the file, which then has no index yet."""
        ...


def ends_a_run(event: Event) -> bool:
    """Whether the process may end right after an event."""
    return isinstance(event, RunFinished) or (isinstance(event, ErrorOccurred) and event.fatal)


def keep_writing(
    writer: RecordingWriter,
    take: Callable[[float], Event | None],
    done: Callable[[Event], None],
    flush_secs: float,
) -> None:
    """Write events until there are no more, then close the writer, also where one could not be written.

    `take` gives the next event, or None at the end, and raises `queue.Empty` where none came within so many
    seconds; `done` is told of each event once it is written.
    """
    due = time.monotonic() + flush_secs
    try:
        while True:
            try:
                event = take(max(0.0, due - time.monotonic()))
            except queue.Empty:
                writer.flush()
                due = time.monotonic() + flush_secs
                continue
            if event is None:
                break
            try:
                writer.write(event)
                if time.monotonic() >= due or isinstance(event, ErrorOccurred | RunFinished):
                    writer.flush()
                    due = time.monotonic() + flush_secs
            finally:
                done(event)
    finally:
        writer.close()


class WriterThread:
    """Writes on a thread of this process."""

    def __init__(self, settings: Settings) -> None:
        self._queue: queue.Queue[Event | None] = queue.Queue(settings.queue_size)
        self._failure: BaseException | None = None
        self._closed = False
        self._thread = threading.Thread(
            target=self._work, args=(settings.writer(), settings.flush_secs), name="rerun-writer", daemon=True
        )
        self._thread.start()

    def tell(self, event: Event) -> None:
        """Queue an event; waits while the queue is full."""
        self._raise_failure()
        self._queue.put(event)
        if ends_a_run(event):
            self._queue.join()
            self._raise_failure()

    def close(self) -> None:
        """Write what is queued, and close the file."""
        if not self._closed:
            self._closed = True
            self._queue.put(None)
            self._thread.join()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _work(self, writer: RecordingWriter, flush_secs: float) -> None:
        try:
            keep_writing(
                writer,
                lambda seconds: self._queue.get(timeout=seconds),
                lambda _event: self._queue.task_done(),
                flush_secs,
            )
        except BaseException as error:
            self._failure = error
            self._drain()

    def _drain(self) -> None:
        """Nobody may wait for ever for a writer that has stopped."""
        while not self._closed or not self._queue.empty():
            try:
                self._queue.get(timeout=0.2)
            except queue.Empty:
                continue
            self._queue.task_done()
