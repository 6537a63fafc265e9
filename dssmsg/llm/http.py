"""HTTP with bounds, through the HTTP package that the client libraries bring along."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import httpx2

from dssmsg.llm.faults import AnswerTooLong, lower
from dssmsg.llm.provider import ProviderFault


class _Bounded(httpx2.SyncByteStream):
    """A body that ends with AnswerTooLong where it goes on beyond `limit` bytes."""

    def __init__(self, stream: httpx2.SyncByteStream, limit: int) -> None:
        self._stream = stream
        self._limit = limit

    def __iter__(self) -> Iterator[bytes]:
        read = 0
        for chunk in self._stream:
            read += len(chunk)
            if read > self._limit:
                raise AnswerTooLong(f"the answer is longer than {self._limit} bytes (max_answer_bytes)")
            yield chunk

    def close(self) -> None:
        self._stream.close()


def bounded(limit: int) -> Callable[[httpx2.Response], None]:
    """A response hook that bounds every body, those of errors too, to `limit` bytes."""

    def hook(response: httpx2.Response) -> None:
        packed = response.headers.get("content-encoding", "identity").strip().lower()
        if packed not in ("", "identity"):
            raise AnswerTooLong(f"the answer is packed ({packed}), which was not asked for")
        assert isinstance(response.stream, httpx2.SyncByteStream)  # a sync client has no other
        response.stream = _Bounded(response.stream, limit)

    return hook


def client_options(secs: float, limit: int) -> dict[str, Any]:
    """Options of an HTTP client: bounded, and never sent elsewhere, since a key would go along."""
    return {
        "timeout": secs,
        "follow_redirects": False,
        "headers": {"Accept-Encoding": "identity"},
        "event_hooks": {"response": [bounded(limit)]},
    }


def json_body(response: httpx2.Response) -> Mapping[str, Any]:
    """The JSON object in a good response. Raises ProviderFault for anything else."""
    kind = response.headers.get("content-type", "").partition(";")[0].strip().lower()
    headers = lower(response.headers)
    if kind != "application/json" and not kind.endswith("+json"):
        start = response.content.decode("utf-8", "replace")
        raise ProviderFault(
            f"expected application/json, the server sent {kind or 'no content type'}: {start}",
            retry=True,
            headers=headers,
        )
    try:
        body = json.loads(response.content)
    except (ValueError, RecursionError) as error:
        raise ProviderFault(f"the body is no JSON: {error}", retry=True, headers=headers) from None
    if not isinstance(body, dict):
        raise ProviderFault(f"expected a JSON object, got {type(body).__name__}", retry=True, headers=headers)
    return body
