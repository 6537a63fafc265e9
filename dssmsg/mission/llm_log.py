"""Every call of an LLM is an event, failed ones too: who asked what, what came back, how long it took."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any

from dssmsg import checks
from dssmsg.errors import PluginError
from dssmsg.events import Event, LlmCalled
from dssmsg.interfaces import Answer, Llm, Message
from dssmsg.llm_requests import request_hash, schema_faults


class LoggedLlm:
    """The `llm` plug-in as everybody gets it: the plug-in itself, with each call told to the observers.

    `now` gives the frame index and sim time of the call.
    """

    def __init__(
        self, llm: Llm, provider: str, tell: Callable[[Event], None], now: Callable[[], tuple[int, float]]
    ) -> None:
        self._llm = llm
        self._provider = provider
        self._tell = tell
        self._now = now

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The plug-in's answer, or its error."""
        start = perf_counter()
        try:
            answer = checks.check_answer(self._llm.complete(role, messages, schema))
            faults = schema_faults(answer.value, schema)
            if faults:
                raise PluginError(f"the answer does not fit: {faults[0]}", plugin=f"llm/{self._provider}")
        except Exception as error:
            self._report(role, messages, schema, start, error=f"{type(error).__name__}: {error}")
            raise
        self._report(role, messages, schema, start, answer=answer)
        return answer

    def _report(
        self,
        role: str,
        messages: Sequence[Message],
        schema: Mapping[str, Any],
        start: float,
        *,
        answer: Answer | None = None,
        error: str = "",
    ) -> None:
        frame, sim_time = self._now()
        self._tell(
            LlmCalled(
                role=role,
                provider=self._provider,
                frame=frame,
                sim_time=sim_time,
                prompt="\n\n".join(f"{message.role}: {message.content}" for message in messages),
                answer="" if answer is None else answer.text,
                request_hash=request_hash(role, messages, schema),
                ok=answer is not None,
                error=error,
                tokens=None if answer is None else answer.tokens,
                seconds=perf_counter() - start,
            )
        )
