"""llm `recorded`: what an earlier run asked and was told, failures and stand-ins included."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from dssmsg_plugins.llm.recorded import Config, Recorded

from dssmsg.errors import PluginError
from dssmsg.interfaces.llm import Answer, Exchange, Message
from dssmsg.llm_requests import request_hash

SCHEMA = {"type": "object", "required": ["n"], "properties": {"n": {"type": "integer"}}}


def asked(word: str) -> list[Message]:
    return [Message("user", word)]


def call(word: str, number: int | None) -> dict[str, Any]:
    """A recorded call: an answer, or with None a failure."""
    return {
        "request_hash": request_hash("count", asked(word), SCHEMA),
        "answer": "" if number is None else json.dumps({"n": number}),
        "ok": number is not None,
        "error": "down" if number is None else "",
        "tokens": 3,
    }


class Counter:
    """A stand-in that always says 9."""

    def complete(self, role: str, messages: Any, schema: Any) -> Answer:
        if messages[0].content == "impossible":
            raise PluginError("cannot count that", plugin="llm/counter")
        return Answer({"n": 9}, '{"n": 9}', None)


def make(monkeypatch: pytest.MonkeyPatch, calls: list[dict[str, Any]], **options: Any) -> Recorded:
    class Fake:
        path = Path("a.rrd")

        @classmethod
        def open(cls, path: Path) -> Fake:
            return cls()

        def __enter__(self) -> Fake:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def llm_calls(self) -> list[dict[str, Any]]:
            return calls

    monkeypatch.setattr("dssmsg.recording.reader.Recording", Fake)
    context: Any = SimpleNamespace(base_dir=Path("/"), build=lambda kind, slot, option: Counter())
    return Recorded(Config.model_validate({"recording": "a.rrd", **options}), context)


def numbers(llm: Recorded, *words: str) -> list[Any]:
    found: list[Any] = []
    for word in words:
        try:
            found.append(llm.complete("count", asked(word), SCHEMA).value["n"])
        except PluginError as error:
            found.append(str(error))
    return found


def test_what_found_no_answer_then_finds_none_now(monkeypatch: pytest.MonkeyPatch) -> None:
    # Two tries of one question, both failed; later the question was asked again, and answered.
    llm = make(monkeypatch, [call("a", None), call("a", None), call("b", 2), call("a", 1)])
    first, *rest = numbers(llm, "a", "a", "a", "b")
    assert "had no answer to this count request: down" in first
    assert rest == [1, 1, 2]


def test_a_try_that_failed_is_not_a_question(monkeypatch: pytest.MonkeyPatch) -> None:
    llm = make(monkeypatch, [call("a", None), call("a", 1), call("a", 3)])
    assert numbers(llm, "a", "a") == [1, 3]


def test_a_fallback_answers_what_was_never_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Exchange] = []
    llm = make(monkeypatch, [call("b", 2)], fallback={"use": "counter"})
    llm.tell_exchanges(told.append)
    assert numbers(llm, "a", "b")[:2] == [9, 2]
    assert "cannot count that" in numbers(llm, "impossible")[0]
    assert [(one.provider, one.fallback_for, bool(one.error)) for one in told] == [
        ("counter", "recorded", False),
        ("recorded", "", False),
        ("counter", "recorded", True),
    ]


def test_without_one_it_says_how_many_answers_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    llm = make(monkeypatch, [call("b", 2)])
    assert "holds no answer to this count request; it has 1 answers" in numbers(llm, "a")[0]
