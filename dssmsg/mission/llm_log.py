"""Every call of an LLM is an event, failed ones too: who asked what, what came back, how long it took."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from time import perf_counter
from typing import Any

from dssmsg import checks
from dssmsg.errors import PluginError
from dssmsg.events import Event, LlmCalled
from dssmsg.interfaces import Answer, Exchange, Llm, Message, TellsExchanges
from dssmsg.llm.secrets import Redactor, environment_secrets
from dssmsg.llm_requests import request_hash, schema_faults


class LoggedLlm:
    """The `llm` plug-in as everybody gets it: the plug-in itself, with each call told to the observers.

    A plug-in that tells its exchanges gets one event for each of them, all with the hash of the question; any
    other gets one an answer. Keys of the environment reach no event and no error, whatever the plug-in does.
    `now` gives the frame index and sim time of the call. A call stands in `watching()`, so that the watchdog
    counts its time for the llm: a plug-in that asks twenty questions in one frame does not hang.
    """

    def __init__(
        self,
        llm: Llm,
        provider: str,
        tell: Callable[[Event], None],
        now: Callable[[], tuple[int, float]],
        watching: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._llm = llm
        self._provider = provider
        self._tell = tell
        self._now = now
        self._watching = watching
        self._redact = Redactor(environment_secrets())
        self._question = ("", "")
        """Role and hash of the question under way."""
        self._told = 0
        self._tells_itself = isinstance(llm, TellsExchanges)
        if isinstance(llm, TellsExchanges):
            llm.tell_exchanges(self._exchanged)

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The plug-in's answer, or its error."""
        start, self._told = perf_counter(), 0
        self._question = (role, request_hash(role, messages, schema))
        try:
            with self._watching():
                answer = checks.check_answer(self._llm.complete(role, messages, schema))
            faults = schema_faults(answer.value, schema)
            if faults:
                raise PluginError(f"the answer does not fit: {faults[0]}", plugin=f"llm/{self._provider}")
        except Exception as error:
            said = f"{type(error).__name__}: {error}"
            if not self._told:
                self._report(messages, start, error=said)
            if self._redact(said) != said:
                raise PluginError(self._redact(said), plugin=f"llm/{self._provider}") from None
            raise
        if not self._tells_itself:
            self._report(messages, start, answer=answer)
        return answer

    def _report(
        self, messages: Sequence[Message], start: float, *, answer: Answer | None = None, error: str = ""
    ) -> None:
        self._exchanged(
            Exchange(
                provider=self._provider,
                messages=tuple(messages),
                text="" if answer is None else answer.text,
                error=error,
                tokens=None if answer is None else answer.tokens,
                seconds=perf_counter() - start,
            )
        )

    def _exchanged(self, exchange: Exchange) -> None:
        self._told += 1
        role, key = self._question
        frame, sim_time = self._now()
        prompt = "\n\n".join(f"{message.role}: {message.content}" for message in exchange.messages)
        self._tell(
            LlmCalled(
                role=role,
                provider=exchange.provider,
                frame=frame,
                sim_time=sim_time,
                prompt=self._redact(prompt),
                answer=self._redact(exchange.text),
                request_hash=key,
                ok=not exchange.error,
                error=self._redact(exchange.error),
                tokens=exchange.tokens,
                seconds=exchange.seconds,
                attempt=exchange.attempt,
                fallback_for=exchange.fallback_for,
            )
        )
