"""The frame of an `.rrd` file: a header, then messages, each with its kind and length; at the end an index.

    header     12 bytes: "RRF2", version, options
    message    16 bytes (kind, length of the payload, both little-endian u64), then the payload
    footer     a message of kind 0 that holds the index, and 12 bytes that end in "RRF2FOOT" and a version

Known so far, a stream can be appended to, and cut off, between any two messages.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from dssmsg.errors import StorageError

MAGIC = b"RRF2"
HEADER_BYTES = 12
FOOTER_MAGIC = b"RRF2FOOT"
TRAILER_BYTES = 12
"""The last bytes of a finished file; they begin with `FOOTER_MAGIC`."""

_MESSAGE = struct.Struct("<QQ")
_END, _STORE_INFO = 0, 1
_KINDS = range(16)  # few kinds exist; a number far above is no message header


class MessageFile:
    """An `.rrd` file that is appended to: created exclusively, every `append` is in the file when it returns.

    Raises StorageError where the file exists already or cannot be created or written; after a failed write
    it is closed, with as much in it as there was room for.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            handle = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        except FileExistsError as error:
            raise StorageError(
                "a recording of this name exists already and is not overwritten", file=path
            ) from error
        except OSError as error:
            raise StorageError(
                f"the recording cannot be created ({error.strerror}); set recording.directory to a folder"
                " that can be written",
                file=path,
            ) from error
        self._file = os.fdopen(handle, "wb", buffering=0)

    @property
    def closed(self) -> bool:
        """Whether nothing can be appended any more."""
        return self._file.closed

    def append(self, stream: bytes) -> None:
        """Append the messages of a whole stream (header, messages, footer) without its footer."""
        begin, end = messages_span(stream)
        position = self._file.tell()
        data = memoryview(stream)[0 if position == 0 else begin : end]
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._file.close()  # a reader drops the message that was cut off
            raise StorageError(
                f"the recording could not be written ({error.strerror})", file=self.path
            ) from error

    def close(self) -> None:
        """Close the file; safe to call twice."""
        self._file.close()


class MessagePicker:
    """Takes single messages out of a finished file. `first`: where the first one that is asked for lies."""

    def __init__(self, path: Path, first: int) -> None:
        self._path = path
        with path.open("rb") as file:
            begin = [file.read(HEADER_BYTES)]
            position = HEADER_BYTES
            while position < first and len(head := file.read(_MESSAGE.size)) == _MESSAGE.size:
                kind, length = _MESSAGE.unpack(head)
                if kind not in _KINDS or position + length > first:
                    break
                if kind == _STORE_INFO:
                    begin.append(head + file.read(length))
                position = file.seek(position + _MESSAGE.size + length)
        self._begin = b"".join(begin)

    def alone(self, payloads: Sequence[tuple[int, int]]) -> bytes:
        """A stream with nothing but the messages whose payloads begin there and are so long."""
        parts = [self._begin]
        with self._path.open("rb") as file:
            for position, length in payloads:
                file.seek(position - _MESSAGE.size)
                parts.append(file.read(_MESSAGE.size + length))
        return b"".join(parts)


def messages_span(stream: bytes) -> tuple[int, int]:
    """From where to where the messages of a whole stream go; (0, 0) for an empty one.

    Raises ValueError if it is no such stream.
    """
    if not stream:
        return 0, 0
    if not stream.startswith(MAGIC):
        raise ValueError(f"expected a stream that begins with {MAGIC!r}, got {stream[:4]!r}")
    position = HEADER_BYTES
    while position + _MESSAGE.size <= len(stream):
        kind, length = _MESSAGE.unpack_from(stream, position)
        if kind == _END:
            break
        position += _MESSAGE.size + length
    if position > len(stream):
        raise ValueError("the stream ends in the middle of a message")
    return HEADER_BYTES, position


def has_footer(path: Path) -> bool:
    """Whether the file ends in an index."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - TRAILER_BYTES))
        return file.read().startswith(FOOTER_MAGIC)


def whole_length(path: Path) -> int:
    """The length in bytes of the header and of all whole messages that follow it without a gap."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        return max(_message_ends(file, size), default=min(HEADER_BYTES, size))


def _message_ends(file: BinaryIO, size: int) -> Iterator[int]:
    """Where each whole message ends, from the start to the first that is cut off, damaged, or the footer."""
    position = HEADER_BYTES
    while position + _MESSAGE.size <= size:
        file.seek(position)
        kind, length = _MESSAGE.unpack(file.read(_MESSAGE.size))
        position += _MESSAGE.size + length
        if kind == _END or kind not in _KINDS or position > size:
            return
        yield position
