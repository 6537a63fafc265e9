"""How events get from the mission into a recording: by a thread of its own, through a bounded queue.

The mission waits while the queue is full, and nothing is dropped. What is written is flushed every so often,
whether or not anything was told: after `kill -9` the file lacks at most what was told since the last flush,
and what waited in the queue. The thread writes itself, or has another process write (`writer_process`).
"""

from __future__ import annotations

import queue
import threading
import time
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


class Writer(Protocol):
    """A `RecordingWriter`, or one that is elsewhere."""

    def write(self, event: Event) -> None:
        """Take an event into the next flush."""
        ...

    def flush(self) -> None:
        """Bring everything told so far into the file; when a run is over, it is there afterwards."""
        ...

    def close(self) -> None:
        """Flush, and close the file, which then has no index yet."""
        ...


def ends_a_run(event: Event) -> bool:
    """Whether the process may end right after an event."""
    return isinstance(event, RunFinished) or (isinstance(event, ErrorOccurred) and event.fatal)


class WriterThread:
    """Hands events to a writer. Every method raises what stopped it, if anything did."""

    def __init__(self, writer: Writer, settings: Settings) -> None:
        self._writer = writer
        self._flush_secs = settings.flush_secs
        self._queue: queue.Queue[Event | None] = queue.Queue(settings.queue_size)
        self._failure: BaseException | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="rerun-writer", daemon=True)
        self._thread.start()

    def tell(self, event: Event) -> None:
        """Queue an event, waiting while the queue is full; at the end of a run wait until it is written."""
        self._raise_failure()
        self._queue.put(event)
        if ends_a_run(event):
            self._queue.join()
            self._raise_failure()

    def close(self) -> None:
        """Write what is queued, and close the writer."""
        if not self._closed:
            self._closed = True
            self._queue.put(None)
            self._thread.join()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _work(self) -> None:
        try:
            self._write_events()
        except BaseException as error:
            self._failure = error
        try:
            self._writer.close()
        except BaseException as error:
            self._failure = self._failure or error
        if self._failure is not None:
            self._drain()

    def _write_events(self) -> None:
        due = time.monotonic() + self._flush_secs
        while True:
            try:
                event = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except queue.Empty:
                event = _TICK
            if event is None:
                return
            try:
                if event is not _TICK:
                    self._writer.write(event)
                if time.monotonic() >= due or isinstance(event, ErrorOccurred | RunFinished):
                    self._writer.flush()
                    due = time.monotonic() + self._flush_secs
            finally:
                if event is not _TICK:
                    self._queue.task_done()

    def _drain(self) -> None:
        """Nobody may wait for ever for a writer that has stopped."""
        while not self._closed or not self._queue.empty():
            try:
                self._queue.get(timeout=0.2)
            except queue.Empty:
                continue
            self._queue.task_done()


_TICK: Event = object()  # type: ignore[assignment]
