"""A recording written by a process of its own: the mission's process keeps its time for the map.

Python runs one thread at a time, so a writer on a thread costs the mission what it works. Worth the start of
a process where the mission is short of time, as in a replay. Where the recorded images are copied, frames
cross without them. If the mission's process is killed, what was told until then is still written.
"""

from __future__ import annotations

import copyreg
import io
import math
import pickle
import queue
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import StorageError
from dssmsg.events import Event, FrameCaptured, TruthSeen
from dssmsg.frame import MaskArray, TruthObject
from dssmsg.processes import start_sheltered
from dssmsg.recording.lazy_frame import Elsewhere, LazyFrame, LazyTruth
from dssmsg.recording.writing import Settings, ends_a_run, keep_writing

_END = b""
_DONE = "done"
_SAME: Any = "same"
"""Stands for the objects of the truth before."""


class WriterProcess:
    """Starts the process at once, which makes the file when it is first told something.

    The process imports the program's main module, which must do nothing when it is imported.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._failure: Exception | None = None
        self._closed = False
        self._objects: Sequence[TruthObject] | None = None
        self._sending = threading.Lock()  # a hung mission is closed by its watchdog
        context = get_context("spawn")  # not forked: Rerun holds threads
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(settings, theirs), name="dssmsg-writer", daemon=True
        )
        start_sheltered(self._process)
        theirs.close()

    def tell(self, event: Event) -> None:
        """Send an event; waits where the writer is far behind."""
        self._raise_failure()
        if self._pipe.poll():  # it speaks unasked only of a failure
            self._receive()
        self._send(_packed(self._bare(event) if self._settings.copied else event))
        if ends_a_run(event):
            self._receive()

    def close(self) -> None:
        """Have everything written and the file closed, and the process ended."""
        if not self._closed:
            self._closed = True
            try:
                if self._failure is None:
                    self._send(_END)
                    self._receive()
            finally:
                self._pipe.close()
                self._process.join()
        self._raise_failure()

    def _bare(self, event: Event) -> Event:
        """An event without images, and without truths' objects that are those of the truth before."""
        if isinstance(event, FrameCaptured):
            return replace(event, frame=LazyFrame.like(event.frame, rgb=Elsewhere(), depth=Elsewhere()))
        if isinstance(event, TruthSeen):
            objects, known = event.truth.objects, self._objects
            self._objects = objects
            return replace(event, truth=LazyTruth(Elsewhere(), _SAME if objects is known else objects))
        return event

    def _send(self, data: bytes) -> None:
        try:
            with self._sending:
                self._pipe.send_bytes(data)
        except OSError:
            self._receive()  # why it listens no more

    def _receive(self) -> None:
        """Wait for an answer; what stopped the writer is raised."""
        try:
            kind, message, trace = self._pipe.recv()
        except (EOFError, OSError):
            kind, message, trace = StorageError.kind, "the process that writes it was ended", ""
        if kind == _DONE:
            return
        if kind == StorageError.kind:
            self._failure = StorageError(message, file=self._settings.path)
        else:
            self._failure = RuntimeError(f"{kind}: {message}\n{trace}")
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure


def _packed(event: Event) -> bytes:
    buffer = io.BytesIO()
    pickler = pickle.Pickler(buffer, pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = _CROSSING
    pickler.dump(event)
    return buffer.getvalue()


def _array(values: NDArray[Any]) -> Any:
    """Masks are most of what crosses: as bits."""
    if values.dtype != np.bool_:
        return values.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
    return _unpacked, (np.packbits(values).tobytes(), values.shape)


def _unpacked(bits: bytes, shape: tuple[int, ...]) -> MaskArray:
    count = math.prod(shape)
    return np.unpackbits(np.frombuffer(bits, np.uint8), count=count).view(np.bool_).reshape(shape)


def _mapping(values: Mapping[Any, Any]) -> Any:
    return _read_only, (dict(values),)


def _read_only(values: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(values)


_CROSSING: dict[type, Callable[[Any], Any]] = {
    **copyreg.dispatch_table,
    np.ndarray: _array,
    MappingProxyType: _mapping,
}
"""How values cross to the writer's process that do so badly, or not at all, as they are."""


# The writer's side.


def _serve(settings: Settings, pipe: Connection) -> None:
    import dssmsg.recording.writer  # noqa: F401 - takes a second: while the mission is put together

    waiting: queue.Queue[bytes] = queue.Queue(settings.queue_size)
    threading.Thread(target=_listen, args=(pipe, waiting), daemon=True).start()
    try:
        first = waiting.get()
        if first:
            _write(settings, pipe, first, waiting)
        answer = (_DONE, "", "")
    except StorageError as error:
        answer = (error.kind, error.message, "")
    except BaseException as error:
        answer = (type(error).__name__, str(error), traceback.format_exc())
    try:
        pipe.send(answer)
    except OSError:
        return  # nobody listens any more


def _write(settings: Settings, pipe: Connection, first: bytes, waiting: queue.Queue[bytes]) -> None:
    began = [first]
    objects: Sequence[TruthObject] = ()

    def take(seconds: float) -> Event | None:
        nonlocal objects
        data = began.pop() if began else waiting.get(timeout=seconds)
        event: Event | None = pickle.loads(data) if data else None
        if isinstance(event, TruthSeen):
            if event.truth.objects == _SAME:
                event = replace(event, truth=LazyTruth(Elsewhere(), tuple(objects)))
            objects = event.truth.objects
        return event

    def done(event: Event) -> None:
        if ends_a_run(event):
            pipe.send((_DONE, "", ""))

    keep_writing(settings.writer(), take, done, settings.flush_secs)


def _listen(pipe: Connection, waiting: queue.Queue[bytes]) -> None:
    """Receiving waits for the mission; writing goes on meanwhile."""
    data = None
    while data != _END:
        try:
            data = pipe.recv_bytes()
        except (EOFError, OSError):  # the mission was killed
            data = _END
        waiting.put(data)
