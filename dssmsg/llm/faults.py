"""What the exceptions of client libraries mean: whether to try again, when, and what to tell the user.

Texts are not cut here: whoever tells them hides keys first, and half a key would not be found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from dssmsg.llm.provider import ProviderFault

_PASSING = frozenset({408, 409, 425, 429})
"""Below 500, what may pass: time-outs, conflicts, rate limits; from 500 on everything may."""
_CONNECTION = ("Connect", "RemoteProtocol", "Read", "Write", "APIConnection")
"""How the classes of errors about a connection begin, in every client library."""
_REFUSED = frozenset({400, 422})


class AnswerTooLong(Exception):
    """A server sent more than is read, or something that may unpack to more."""


def lower(headers: Any) -> dict[str, str]:
    """Headers with lower-case names."""
    return {str(name).lower(): str(value) for name, value in dict(headers or {}).items()}


def fault_of(error: Exception) -> ProviderFault:
    """What an exception of a client library means, by its status, its class and its causes.

    The libraries of the two protocols, and what stands on them, name these alike.
    """
    for one in _causes(error):
        if isinstance(one, AnswerTooLong):
            return ProviderFault(str(one), retry=False)
    response = getattr(error, "response", None)
    status = getattr(error, "status_code", None) or getattr(response, "status_code", None)
    if isinstance(status, int):
        return _of_status(status, error, lower(getattr(response, "headers", None)))
    name = type(error).__name__
    roots = [type(one).__name__ for one in _causes(error)]
    if any("Timeout" in one for one in roots):
        return ProviderFault(f"no answer in time ({name})", retry=True)
    if any(one.startswith(_CONNECTION) for one in roots):
        return ProviderFault(f"no connection: {_root(error)}", retry=True)
    return ProviderFault(f"{name}: {error}", retry=False)


def _of_status(status: int, error: Exception, headers: Mapping[str, str]) -> ProviderFault:
    code = str(getattr(error, "code", "") or "")
    said = " ".join(_said(error).split())
    hint = {401: " (is the key right?)", 403: " (is the key right?)", 404: " (are base_url and model right?)"}
    passing = (status in _PASSING or status >= 500) and code != "insufficient_quota"
    return ProviderFault(
        f"HTTP {status}{hint.get(status, '')}: {said}",
        retry=passing,
        simpler=status in _REFUSED,
        headers=headers,
    )


def _said(error: Exception) -> str:
    """The server's own words where its body has the form of either protocol, else the library's."""
    body = getattr(error, "body", None)
    for part in (body.get("error"), body) if isinstance(body, dict) else ():
        if isinstance(part, dict) and isinstance(part.get("message"), str):
            words: str = part["message"]
            return words
    return str(getattr(error, "message", "") or error)


def _causes(error: BaseException) -> Iterator[BaseException]:
    seen: BaseException | None = error
    for _ in range(10):
        if seen is None:
            return
        yield seen
        seen = seen.__cause__ or seen.__context__


def _root(error: BaseException) -> str:
    *_, root = _causes(error)
    return f"{type(root).__name__}: {root}"
