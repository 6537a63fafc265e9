"""observer `rerun`: writes the run into `<run_id>.rrd`, on a thread or in a process of its own.

The mission hands events over through a bounded queue that blocks and never drops: `dssmsg.recording.writing`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from dssmsg.errors import StorageError
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.recording.writer_process import FarWriter
from dssmsg.recording.writing import Settings, WriterThread

if TYPE_CHECKING:
    from dssmsg.events import Event
    from dssmsg.interfaces import Context
    from dssmsg.recording.reader import Recording


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
    process: bool = Field(
        default=False,
        description="write in a process of its own, which costs its start and spares the mission the work; it"
        " imports the program's main module",
    )


class RerunObserver:
    """Writes every event to a recording. If writing failed, the next call raises StorageError.

    Raises InputError if `copy_images` does not read.
    """

    def __init__(self, config: Config, context: Context) -> None:
        self._copied: Recording | None = None
        if config.copy_images is not None:
            from dssmsg.recording.reader import Recording

            # Held open: the writer, in whichever process, reads the copy that was repaired in this one.
            self._copied = Recording.open(context.base_dir / config.copy_images)
        self._settings = Settings(
            Path(context.run_dir) / f"{context.run_id}.rrd",
            context.run_id,
            config.images,
            config.quality,
            config.layout,
            None if self._copied is None else self._copied.readable_path,
            config.flush_secs,
            config.queue_size,
        )
        self._log = context.log
        # A process takes a second until it can write, so it is started before there is anything to write.
        self._far = FarWriter(self._settings) if config.process else None
        self._thread: WriterThread | None = None
        self._closed = False

    def on_event(self, event: Event) -> None:
        """Hand an event to the writer; waits while it is far behind. Raises what stopped it, if anything did.

        The file is created on the first event, so that a run that never begins leaves none.
        """
        if self._thread is None:
            self._thread = WriterThread(self._far or self._settings.writer(), self._settings)
        self._thread.tell(event)

    def close(self) -> None:
        """Write what is queued, and compact the file. Raises StorageError if writing failed."""
        try:
            self._finish()
        finally:
            if self._copied is not None:
                self._copied.close()

    def _finish(self) -> None:
        if self._thread is None:
            if self._far is not None:
                self._far.close()
            return
        self._thread.close()
        if self._closed:
            return
        self._closed = True
        from dssmsg.recording.repair import optimize

        try:
            optimize(self._settings.path)
        except StorageError as error:
            self._log.warning("%s", error)

    def outputs(self) -> dict[str, str]:
        """`recording`: the file, once there is one."""
        return {"recording": str(self._settings.path)} if self._thread is not None else {}


@hookimpl
def register_observer(register: Register) -> None:
    """Announce `rerun`."""
    register("rerun", RerunObserver, config=Config)
