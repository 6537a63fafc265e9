"""What one exchange with a model gives: a reply, or a fault that says what may be done about it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True, eq=False)
class Reply:
    """The raw text of a model; `headers` with lower-case names where it came by HTTP.

    `cut` says why the text ends early (the token limit), where the server tells.
    """

    text: str
    tokens: int | None = None
    headers: Mapping[str, str] = field(default_factory=dict)
    cut: str = ""


class ProviderFault(Exception):
    """An exchange that gave no text.

    `retry`: the same request may succeed later. `simpler`: it may without the schema in the request, which
    not every server knows. `headers` as in `Reply`.
    """

    def __init__(
        self,
        message: str,
        *,
        retry: bool,
        simpler: bool = False,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(message)
        self.retry = retry
        self.simpler = simpler
        self.headers = dict(headers or {})


def call_within(secs: float, function: Callable[[], Reply]) -> Reply:
    """`function()` on a thread of its own; ProviderFault if it takes longer than `secs`.

    A client's own time-out counts the silence between two bytes, so a server that drips holds it for ever.
    Python cannot cancel a call: the thread is left behind, and ends with its connection or with the process.
    """
    done: list[Any] = []

    def work() -> None:
        try:
            done.append(function())
        except BaseException as error:  # raised again below, on the thread that asked
            done.append(error)

    thread = threading.Thread(target=work, name="dssmsg-llm", daemon=True)
    thread.start()
    thread.join(secs)
    if not done:
        raise ProviderFault(f"no answer within {secs:.3g} s", retry=True)
    if isinstance(done[0], BaseException):
        raise done[0]
    reply: Reply = done[0]
    return reply
