"""observer `rerun`: writes the run into `<run_id>.rrd`, on a thread of its own.

The mission hands events over through a bounded queue that blocks and never drops; encoding and writing
happen on the worker, which flushes every second whether or not anything was told. After `kill -9` the file
lacks at most what was told since the last flush, and what waited in the queue.
"""

from __future__ import annotations

import queue
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from dssmsg.errors import StorageError
from dssmsg.events import ErrorOccurred, Event, RunFinished
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context
    from dssmsg.recording.writer import RecordingWriter


class Config(PluginConfig):
    """Options of the Rerun recording."""

    images: Literal["jpeg", "lossless"] = Field(
        default="jpeg", description="colour images: jpeg (small) or lossless (PNG); depth is always lossless"
    )
    quality: int = Field(default=80, ge=1, le=95, description="JPEG quality")
    copy_images: Path | None = Field(
        default=None, description="a recording of the same frames, whose encoded images are copied"
    )
    layout: Literal["review", "scene", "graph", "dynamics", "language", "navigation"] = Field(
        default="review", description="what the viewer shows when it opens the file"
    )
    queue_size: int = Field(
        default=64, ge=1, le=4096, description="events that may wait for the writer before the mission waits"
    )
    flush_secs: float = Field(
        default=1.0,
        ge=0.1,
        le=2.0,
        description="wall seconds between two flushes; a crash loses about that much",
    )


class RerunObserver:
    """Writes every event to a recording. If writing failed, the next call raises StorageError."""

    def __init__(self, config: Config, context: Context) -> None:
        self._config = config
        self._log = context.log
        self._run_id = context.run_id
        self._copied = None if config.copy_images is None else context.base_dir / config.copy_images
        self._path = Path(context.run_dir) / f"{context.run_id}.rrd"
        self._queue: queue.Queue[Event | None] = queue.Queue(config.queue_size)
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None
        self._closed = False

    def on_event(self, event: Event) -> None:
        """Queue an event; waits while the queue is full. Raises what stopped the writer, if anything did.

        The file is created on the first event, so that a run that never begins leaves none.
        """
        if self._thread is None:
            self._start()
        self._raise_failure()
        self._queue.put(event)
        if isinstance(event, RunFinished) or (isinstance(event, ErrorOccurred) and event.fatal):
            self._queue.join()  # the process may end right after this
            self._raise_failure()

    def _start(self) -> None:
        from dssmsg.recording.writer import RecordingWriter

        writer = RecordingWriter(
            self._path,
            self._run_id,
            images=self._config.images,
            quality=self._config.quality,
            layout=self._config.layout,
            copied=self._copied,
        )
        self._thread = threading.Thread(target=self._work, args=(writer,), name="rerun-writer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Write what is queued, and compact the file. Raises StorageError if writing failed."""
        if self._closed or self._thread is None:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        self._raise_failure()
        from dssmsg.recording.repair import optimize

        try:
            optimize(self._path)
        except StorageError as error:
            self._log.warning("%s", error)

    def outputs(self) -> dict[str, str]:
        """`recording`: the file, once there is one."""
        return {} if self._thread is None else {"recording": str(self._path)}

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _work(self, writer: RecordingWriter) -> None:
        try:
            self._write_events(writer)
        except BaseException as error:
            self._failure = error
        try:
            writer.close()
        except BaseException as error:
            self._failure = self._failure or error
        if self._failure is not None:
            self._drain()

    def _write_events(self, writer: RecordingWriter) -> None:
        due = time.monotonic() + self._config.flush_secs
        while True:
            try:
                event = self._queue.get(timeout=max(0.0, due - time.monotonic()))
            except queue.Empty:
                event = _TICK
            try:
                if event is None:
                    return
                if isinstance(event, Event):
                    writer.write(event)
                if (
                    event is _TICK
                    or time.monotonic() >= due
                    or isinstance(event, (ErrorOccurred, RunFinished))
                ):
                    writer.flush()
                    due = time.monotonic() + self._config.flush_secs
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


_TICK: Any = object()


@hookimpl
def register_observer(register: Register) -> None:
    """Announce `rerun`."""
    register("rerun", RerunObserver, config=Config)
