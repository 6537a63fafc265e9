"""One question to a model that may be slow, down, rate-limited or wrong: tries, repair, fallback.

    try -> fault that may pass -> wait (what the server says, else doubling back-off) -> try again
        -> answer that does not fit -> once more, with what is wrong
        -> the fallback, built by the host like any slot

Everything happens within one budget of seconds, and each exchange is told as soon as it is over.
"""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

from dssmsg.checks import check_answer
from dssmsg.errors import DssmsgError, PluginError
from dssmsg.interfaces.llm import Answer, Exchange, Llm, Message, TellsExchanges
from dssmsg.llm.options import RemoteOptions
from dssmsg.llm.provider import ProviderFault, Reply, call_within
from dssmsg.llm.rate_limits import quiet_secs, wait_secs
from dssmsg.llm.secrets import Redactor, environment_secrets
from dssmsg.llm_requests import parse_answer, schema_faults

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

SHARE = 0.8
"""Of the run's `timeout_secs`, after which the watchdog ends the run."""
_SHORTEST_TRY = 0.05
_NOT_ASKED = "not asked"
_SHOWN_ANSWER = 4000
_SHOWN_FAULT = 400


class RemoteLlm(ABC):
    """Base of an `llm` plug-in: the plug-in sends one request, this does everything around it.

    `name` is the registered name; `keys` are hidden from whatever is told or raised. `sleep` and `clock` are
    for tests.
    """

    def __init__(
        self,
        name: str,
        options: RemoteOptions,
        context: Context,
        *,
        keys: Iterable[str | None] = (),
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._name = name
        self._options = options
        self._rng = context.rng
        self._log = context.log
        self._redact = Redactor([*keys, *environment_secrets()])
        self._sleep, self._clock = sleep, clock
        self._tell: Callable[[Exchange], None] = lambda exchange: None
        self._budget_secs = min(options.budget_secs or float("inf"), SHARE * context.timeout_secs)
        self._structured = options.structured != "off"
        self._not_before = -float("inf")
        self._rests = False
        self._fallback: Llm | None = None
        if options.fallback is not None:
            self._fallback = context.build("llm", options.fallback, option="fallback")

    @abstractmethod
    def send(
        self, messages: Sequence[Message], schema: Mapping[str, Any], secs: float, *, structured: bool
    ) -> Reply:
        """One request, on a thread of its own; `structured`: with the schema in the request.

        Raises ProviderFault; any other exception counts as one that does not pass.
        """

    def tell_exchanges(self, tell: Callable[[Exchange], None]) -> None:
        """Call `tell` for every exchange from now on, those of the fallback included."""
        self._tell = tell
        if isinstance(self._fallback, TellsExchanges):
            self._fallback.tell_exchanges(
                lambda one: tell(replace(one, fallback_for=self._stands_in_for(one)))
            )

    def complete(self, role: str, messages: Sequence[Message], schema: Mapping[str, Any]) -> Answer:
        """The answer of the model, or of the fallback. Raises PluginError when neither has one."""
        return self.complete_within(self._budget_secs, role, messages, schema)

    def complete_within(
        self, secs: float, role: str, messages: Sequence[Message], schema: Mapping[str, Any]
    ) -> Answer:
        """`complete`, done after `secs` at the latest (where the fallback is local: about then)."""
        end = self._clock() + secs
        # A fallback over the network needs time of its own.
        own_end = end - secs / 2 if isinstance(self._fallback, RemoteLlm) else end
        question = _Question(role, tuple(messages), schema, own_end)
        try:
            return self._ask(question)
        except _GivenUp as given_up:
            return self._fall_back(question, str(given_up), end)

    # One question

    def _ask(self, question: _Question) -> Answer:
        tries, repaired, conversation = 0, False, question.messages
        while True:
            self._wait_for_the_server(question)
            start = self._clock()
            try:
                reply = self._send(question, conversation)
            except ProviderFault as fault:
                error = self._shown(str(fault))
                self._report(question, conversation, start, error=error)
                if fault.simpler and self._options.structured == "auto":
                    # If the request fails without the schema too, that was not what is wrong with it.
                    self._structured = not self._structured
                    if not self._structured:
                        self._log.info(
                            "%s refuses the request, once more with the schema in words", self._name
                        )
                        continue
                tries += 1
                self._wait_to_retry(question, fault, tries, error)
                continue
            text = self._redact(reply.text)
            try:
                value = parse_answer(text, question.schema)
            except ValueError as wrong:
                error = self._shown(f"{wrong} ({reply.cut})" if reply.cut else str(wrong))
                self._report(question, conversation, start, text=text, tokens=reply.tokens, error=error)
                if repaired or not self._options.repair:
                    raise _GivenUp(error) from None
                repaired = True
                conversation = (*question.messages, *_repair(text, error))
                continue
            self._report(question, conversation, start, text=text, tokens=reply.tokens)
            return Answer(value, text, reply.tokens)

    def _send(self, question: _Question, conversation: Sequence[Message]) -> Reply:
        left = question.end - self._clock()
        if left < _SHORTEST_TRY:
            raise _GivenUp(f"no time left for {self._name} ({self._budget_secs:g} s a question)")
        secs = min(self._options.timeout_secs, left)
        structured = self._structured
        try:
            reply = call_within(
                secs, lambda: self.send(conversation, question.schema, secs, structured=structured)
            )
        except ProviderFault:
            raise
        except Exception as error:
            raise ProviderFault(f"{type(error).__name__}: {error}", retry=False) from None
        quiet = quiet_secs(reply.headers)
        if quiet is not None:
            self._not_before = self._clock() + quiet
        return reply

    def _wait_for_the_server(self, question: _Question) -> None:
        """Keep the pause that the server has asked for, or that follows a question it did not answer."""
        pause = self._not_before - self._clock()
        if pause <= 0:
            self._rests = False
            return
        if self._rests or not self._can_wait(question, pause):
            error = f"{_NOT_ASKED}: {self._name} rests for another {pause:.1f} s"
            self._report(question, question.messages, self._clock(), error=error)
            raise _GivenUp(error)
        self._sleep(pause)
        self._not_before = -float("inf")

    def _wait_to_retry(self, question: _Question, fault: ProviderFault, tries: int, error: str) -> None:
        """Sleep before the next try. Raises _GivenUp where there shall be none."""
        if not fault.retry:
            raise _GivenUp(error)
        asked = wait_secs(fault.headers)
        jitter = 0.5 + 0.5 * float(self._rng.random())
        pause = self._options.backoff_secs * 2 ** (tries - 1) * jitter if asked is None else asked
        if tries > self._options.retries or not self._can_wait(question, pause):
            self._rests = True
            self._not_before = self._clock() + max(self._options.rest_secs, asked or 0.0)
            raise _GivenUp(f"{error}; {tries} {'try' if tries == 1 else 'tries'}")
        self._sleep(pause)

    def _can_wait(self, question: _Question, pause: float) -> bool:
        in_time = self._clock() + pause + _SHORTEST_TRY < question.end
        return pause <= self._options.max_wait_secs and in_time

    # Who answers instead

    def _fall_back(self, question: _Question, why: str, end: float) -> Answer:
        if self._fallback is None or self._options.fallback is None:
            self._fail(why)
        other = self._options.fallback.use
        level = logging.INFO if why.startswith(_NOT_ASKED) else logging.WARNING
        self._log.log(level, "%s fails, %s answers: %s", self._name, other, why)
        asked = (question.role, question.messages, question.schema)
        if isinstance(self._fallback, RemoteLlm):
            return self._fallback.complete_within(max(0.0, end - self._clock()), *asked)
        start = self._clock()
        try:
            answer = check_answer(self._fallback.complete(*asked))
            faults = schema_faults(answer.value, question.schema)
            if faults:
                raise PluginError(f"the answer does not fit: {faults[0]}", plugin=f"llm/{other}")
        except Exception as error:
            failed = self._shown(
                str(error) if isinstance(error, DssmsgError) else f"{type(error).__name__}: {error}"
            )
            if not isinstance(self._fallback, TellsExchanges):
                self._report(question, question.messages, start, error=failed, instead=other)
            self._fail(f"{why}; fallback: {failed}")
        if not isinstance(self._fallback, TellsExchanges):
            told, tokens = self._redact(answer.text), answer.tokens
            self._report(question, question.messages, start, text=told, tokens=tokens, instead=other)
        return answer

    def _stands_in_for(self, exchange: Exchange) -> str:
        return exchange.fallback_for or self._name

    def _fail(self, why: str) -> NoReturn:
        raise PluginError(why, plugin=f"llm/{self._name}") from None

    # What is told

    def _report(
        self,
        question: _Question,
        messages: Sequence[Message],
        start: float,
        *,
        text: str = "",
        error: str = "",
        tokens: int | None = None,
        instead: str = "",
    ) -> None:
        question.attempts += 1
        sent = tuple(Message(one.role, self._redact(one.content)) for one in messages)
        self._tell(
            Exchange(
                provider=instead or self._name,
                messages=sent,
                text=text,
                error=error,
                tokens=tokens,
                seconds=self._clock() - start,
                attempt=question.attempts,
                fallback_for=self._name if instead else "",
            )
        )

    def _shown(self, fault: str) -> str:
        """On one line, without keys; cut after that, or half a key would be left."""
        return self._redact(" ".join(fault.split()))[:_SHOWN_FAULT]


class _Question:
    """What was asked, until when it must be answered, and the exchanges so far."""

    __slots__ = ("attempts", "end", "messages", "role", "schema")

    def __init__(
        self, role: str, messages: tuple[Message, ...], schema: Mapping[str, Any], end: float
    ) -> None:
        self.role, self.messages, self.schema, self.end = role, messages, schema, end
        self.attempts = 0


class _GivenUp(Exception):
    """The model does not answer this question; the text says why."""


def _repair(text: str, error: str) -> tuple[Message, Message]:
    """The answer and what is wrong with it. The answer is cut: it may be what was too long."""
    return (
        Message("assistant", text[:_SHOWN_ANSWER] or "(nothing)"),
        Message(
            "user",
            f"That answer cannot be used: {error}. Answer the first message again, with one JSON object that "
            "fits the schema and nothing else.",
        ),
    )
