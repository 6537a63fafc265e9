"""Every call is told once, with its question's hash and without keys, whatever the plug-in does."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import pytest

from dssmsg.errors import PluginError
from dssmsg.events import LlmCalled
from dssmsg.guard import Guard
from dssmsg.interfaces import Answer, Exchange, Message
from dssmsg.llm_requests import request_hash
from dssmsg.mission.llm_log import LoggedLlm

SCHEMA = {"type": "object", "properties": {"a": {"type": "integer"}}}
ASKED = [Message("system", "Count."), Message("user", "How many?")]


class Plain:
    """Somebody's plug-in: says or raises what it is given."""

    def __init__(self, said: Any) -> None:
        self.said = said

    def complete(self, role: str, messages: Any, schema: Any) -> Any:
        if isinstance(self.said, Exception):
            raise self.said
        return self.said


class Telling(Plain):
    """Tells two exchanges before it answers."""

    def tell_exchanges(self, tell: Callable[[Exchange], None]) -> None:
        self.tell = tell

    def complete(self, role: str, messages: Any, schema: Any) -> Any:
        self.tell(Exchange("far", tuple(messages), error="down", attempt=1))
        self.tell(Exchange("near", tuple(messages), text="{}", tokens=3, attempt=2, fallback_for="far"))
        return super().complete(role, messages, schema)


def ask(plugin: Any) -> tuple[Any, list[LlmCalled]]:
    """The answer or the exception, and what was told."""
    told: list[Any] = []
    logged = LoggedLlm(plugin, "mine", told.append, lambda: (4, 0.8))
    try:
        return logged.complete("count", ASKED, SCHEMA), told
    except Exception as error:
        return error, told


def test_a_plain_plugin_is_told_once_an_answer() -> None:
    answer, (call,) = ask(Plain(Answer({"a": 1}, '{"a": 1}', 9)))
    assert answer.value == {"a": 1}
    assert (call.role, call.provider, call.frame, call.sim_time) == ("count", "mine", 4, 0.8)
    assert (call.ok, call.error, call.answer, call.tokens) == (True, "", '{"a": 1}', 9)
    assert call.prompt == "system: Count.\n\nuser: How many?"
    assert call.request_hash == request_hash("count", ASKED, SCHEMA)
    assert (call.attempt, call.fallback_for) == (1, "")


@pytest.mark.parametrize(
    ("said", "kind", "words"),
    [
        (ValueError("boom"), ValueError, "ValueError: boom"),
        (None, Exception, "expected an Answer"),
        (Answer({"a": "x"}, "x"), PluginError, "expected integer, got str"),
    ],
)
def test_a_failed_call_is_told_too(said: Any, kind: type[Exception], words: str) -> None:
    error, (call,) = ask(Plain(said))
    assert isinstance(error, kind)
    assert not call.ok
    assert words in call.error


def test_a_plugin_that_tells_its_exchanges_is_believed() -> None:
    answer, calls = ask(Telling(Answer({}, "{}")))
    assert answer.value == {}
    assert [(one.provider, one.ok, one.attempt, one.fallback_for) for one in calls] == [
        ("far", False, 1, ""),
        ("near", True, 2, "far"),
    ]
    assert {one.request_hash for one in calls} == {request_hash("count", ASKED, SCHEMA)}
    error, calls = ask(Telling(PluginError("nobody answers", plugin="llm/mine")))
    assert isinstance(error, PluginError)
    assert len(calls) == 2


def test_keys_of_the_environment_stay_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOMEBODYS_TOKEN", "open-sesame-4711")
    error, (call,) = ask(Plain(RuntimeError("cannot log in with open-sesame-4711")))
    assert isinstance(error, PluginError)
    assert "sesame" not in str(error) + call.error
    assert "cannot log in with [key]" in call.error
    _answer, (call,) = ask(Plain(Answer({}, "open-sesame-4711")))
    assert call.answer == "[key]"


def test_each_question_has_the_watchdogs_time_for_itself() -> None:
    """A plug-in under the watchdog asks often; only one question that takes too long ends the run."""
    ended: list[int] = []

    def ask_often(guard: Guard, times: int, secs: float) -> None:
        def watching() -> AbstractContextManager[None]:
            return guard.watching("llm/slow", "complete")

        logged = LoggedLlm(Slow(secs), "slow", lambda event: None, lambda: (0, 0.0), watching)
        for _ in range(times):
            logged.complete("count", ASKED, SCHEMA)

    with Guard(timeout_secs=0.5, end_process=ended.append, last_words=lambda error: None) as guard:
        guard.call("update/a", "update", ask_often, guard, 6, 0.12)
        assert ended == []
        guard.call("update/a", "update", ask_often, guard, 1, 1.0)
        assert ended == [1]


class Slow:
    def __init__(self, secs: float) -> None:
        self._secs = secs

    def complete(self, role: str, messages: Any, schema: Any) -> Answer:
        time.sleep(self._secs)
        return Answer({}, "{}")
