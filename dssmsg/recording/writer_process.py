"""A recording written by a process of its own: the mission's process keeps its time for the map.

Python runs one thread at a time, so a writer on a thread costs the mission what it works. Worth the start of
a process where the mission is short of time, as in a replay. Where the recorded images are copied, frames
cross without them. If the mission's process is killed, what was sent until then is still written.
"""

from __future__ import annotations

import io
import math
import os
import pickle
import queue
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dssmsg.errors import StorageError
from dssmsg.events import Event, FrameCaptured, TruthSeen
from dssmsg.frame import MaskArray, TruthObject
from dssmsg.processes import collect_seldom, leave_group, start_sheltered
from dssmsg.recording.lazy_frame import Elsewhere, LazyFrame, LazyTruth
from dssmsg.recording.writing import Settings, ends_a_run

_END = b""
_FLUSH = b"flush"
_DONE = "done"
_SAME: Any = "same"
"""Stands for the objects of the truth before."""


class FarWriter:
    """A `RecordingWriter` in another process, which is started at once and makes the file on the first event.

    Used by one thread, not the main one: an interrupt must not tear a message. Every method raises what
    stopped the writer there, StorageError where its process ended. The process imports the program's main
    module, which must do nothing when it is imported.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._objects: Sequence[TruthObject] | None = None
        self._ending = False
        context = get_context("spawn")  # not forked: Rerun holds threads
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(settings, theirs), name="dssmsg-writer", daemon=True
        )
        start_sheltered(self._process)
        theirs.close()

    def write(self, event: Event) -> None:
        """Send an event; waits where the writer is far behind."""
        if self._pipe.poll():  # it speaks unasked only of a failure
            self._receive()
        self._ending = ends_a_run(event)
        self._send(_packed(self._bare(event) if self._settings.copied else event))

    def flush(self) -> None:
        """Have everything sent so far brought into the file; waits for it where that was the end of a run."""
        self._send(_FLUSH)
        if self._ending:
            self._receive()

    def close(self) -> None:
        """Have the rest written and the file closed, and end the process; safe to call twice."""
        if self._pipe.closed:
            return
        try:
            self._send(_END)
            self._receive()
        finally:
            self._pipe.close()
            self._process.join()

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
            self._pipe.send_bytes(data)
        except OSError:
            self._receive()  # why it listens no more

    def _receive(self) -> None:
        """Wait for an answer; what stopped the writer is raised."""
        try:
            kind, message, trace = self._pipe.recv()
        except (EOFError, OSError):
            kind, message, trace = StorageError.kind, "the process that writes it was ended", ""
        if kind == StorageError.kind:
            raise StorageError(message, file=self._settings.path)
        if kind != _DONE:
            raise RuntimeError(f"{kind}: {message}\n{trace}")


# How events cross.


class _Pickler(pickle.Pickler):
    """Values of a stranger's types cross as what they are to us: the writer's process has not loaded them."""

    def reducer_override(self, value: Any) -> Any:
        kind = type(value)
        reduce = _CROSSING.get(kind)
        if reduce is not None:
            return reduce(value)
        return NotImplemented if kind.__module__.partition(".")[0] in _KNOWN else _as_known(value)


_KNOWN = frozenset({"builtins", "collections", "dssmsg", "dssmsg_plugins", "numpy", "pathlib", "types"})
"""Top-level modules that the writer's process can import."""


_PLAIN: dict[type, Callable[[Any], Any]] = {
    str: str.__str__,
    int: int.__int__,
    float: float.__float__,
    bytes: bytes,
    tuple: tuple,
    list: list,
    dict: dict,
}


def _packed(event: Event) -> bytes:
    buffer = io.BytesIO()
    _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(event)
    return buffer.getvalue()


def _as_known(value: Any) -> Any:
    """A value as one of the nearest class that it inherits from and that is known."""
    for kind in type(value).__mro__[1:]:
        if is_dataclass(kind) and kind.__module__.partition(".")[0] in _KNOWN:
            return kind, tuple(getattr(value, field.name) for field in fields(kind))
    for base, plain in _PLAIN.items():
        if isinstance(value, base):
            return base, (plain(value),)
    return NotImplemented


def _array(values: NDArray[Any]) -> Any:
    """Masks are most of what crosses: as bits."""
    if values.dtype != np.bool_:
        return NotImplemented
    return _unpacked, (np.packbits(values).tobytes(), values.shape)


def _unpacked(bits: bytes, shape: tuple[int, ...]) -> MaskArray:
    count = math.prod(shape)
    return np.unpackbits(np.frombuffer(bits, np.uint8), count=count).view(np.bool_).reshape(shape)


def _mapping(values: Mapping[Any, Any]) -> Any:
    return _read_only, (dict(values),)


def _read_only(values: dict[Any, Any]) -> Mapping[Any, Any]:
    return MappingProxyType(values)


_CROSSING: dict[type, Callable[[Any], Any]] = {np.ndarray: _array, MappingProxyType: _mapping}
"""How values cross that do so badly, or not at all, as they are."""


# The writer's side.


def _serve(settings: Settings, pipe: Connection) -> None:
    leave_group()
    collect_seldom()
    if hasattr(os, "nice"):
        os.nice(10)  # nobody waits for it before the end: where cores are scarce the mission goes first
    import dssmsg.recording.writer  # noqa: F401 - takes a second: while the mission is put together

    waiting: queue.Queue[bytes] = queue.Queue(settings.queue_size)
    threading.Thread(target=_listen, args=(pipe, waiting), daemon=True).start()
    try:
        first = waiting.get()
        if first != _END:
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


def _write(settings: Settings, pipe: Connection, data: bytes, waiting: queue.Queue[bytes]) -> None:
    writer = settings.writer()
    objects: Sequence[TruthObject] = ()
    ending = False
    try:
        while data != _END:
            if data == _FLUSH:
                writer.flush()
                if ending:
                    pipe.send((_DONE, "", ""))
            else:
                event: Event = pickle.loads(data)
                if isinstance(event, TruthSeen):
                    if event.truth.objects == _SAME:
                        event = replace(event, truth=LazyTruth(Elsewhere(), tuple(objects)))
                    objects = event.truth.objects
                ending = ends_a_run(event)
                writer.write(event)
            data = waiting.get()
    finally:
        writer.close()


def _listen(pipe: Connection, waiting: queue.Queue[bytes]) -> None:
    """Receiving waits for the mission; writing goes on meanwhile."""
    data = None
    while data != _END:
        try:
            data = pipe.recv_bytes()
        except (EOFError, OSError):  # the mission was killed
            data = _END
        waiting.put(data)
