"""Rate-limit headers, keys, schemas on the wire, answers in prose: the parts that providers share."""

from __future__ import annotations

import builtins
import json
import re
import threading
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dssmsg_plugins.llm import anthropic, llm, openai
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from dssmsg.config_errors import explain
from dssmsg.dynamic_attribute import DYNAMIC_ATTRIBUTE_SCHEMA
from dssmsg.errors import ConfigError
from dssmsg.llm.options import RemoteOptions
from dssmsg.llm.provider import ProviderFault, Reply, call_within
from dssmsg.llm.rate_limits import LONGEST_SECS, quiet_secs, wait_secs
from dssmsg.llm.secrets import HIDDEN, Redactor, environment_secrets
from dssmsg.llm.wire_schema import schema_words, strict_schema
from dssmsg.llm_requests import parse_answer, schema_faults
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA
from dssmsg.target_graph import parse_target_graph

NOW = datetime(2026, 3, 1, 12, 0, 0, tzinfo=UTC)

# When to ask again.


@pytest.mark.parametrize(
    ("headers", "secs"),
    [
        ({}, None),
        ({"retry-after": "7"}, 7.0),
        ({"retry-after": "0.5"}, 0.5),
        ({"retry-after": "Sun, 01 Mar 2026 12:00:09 GMT"}, 9.0),
        ({"retry-after": "Sun, 01 Mar 2026 11:00:00 GMT"}, 0.0),
        ({"retry-after-ms": "1500", "retry-after": "9"}, 1.5),
        ({"retry-after": "99999999"}, LONGEST_SECS),
        ({"retry-after": "-3"}, None),
        ({"retry-after": "nan"}, None),
        ({"retry-after": "soon"}, None),
        ({"retry-after": "soon", "retry-after-ms": "inf"}, None),
        ({"x-ratelimit-remaining-tokens": "0", "x-ratelimit-reset-tokens": "6m0s"}, 360.0),
        ({"x-ratelimit-remaining-tokens": "5", "x-ratelimit-reset-tokens": "6m0s"}, None),
        ({"x-ratelimit-remaining-requests": "0", "x-ratelimit-reset-requests": "20ms"}, 0.02),
        ({"x-ratelimit-remaining-requests": "0", "x-ratelimit-reset-requests": "never"}, None),
        (
            {
                "anthropic-ratelimit-requests-remaining": "0",
                "anthropic-ratelimit-requests-reset": "2026-03-01T12:00:04Z",
                "anthropic-ratelimit-tokens-remaining": "0",
                "anthropic-ratelimit-tokens-reset": "2026-03-01T12:00:06Z",
            },
            6.0,
        ),
    ],
)
def test_seconds_that_a_server_asks_for(headers: dict[str, str], secs: float | None) -> None:
    assert wait_secs(headers, NOW) == secs


def test_a_good_answer_asks_for_a_pause_only_where_nothing_is_left() -> None:
    assert quiet_secs({"retry-after": "7"}, NOW) is None
    left = {"x-ratelimit-remaining-requests": "0", "x-ratelimit-reset-requests": "1h2m3s"}
    assert quiet_secs(left, NOW) == LONGEST_SECS


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=40) | st.from_regex(r"[0-9:TZ.+,-]{1,30}|\d{1,400}(ms|s|m|h)", fullmatch=True))
def test_no_header_is_too_strange(text: str) -> None:
    names = ("retry-after", "retry-after-ms", "anthropic-ratelimit-tokens-reset")
    for headers in ({name: text} | {"anthropic-ratelimit-tokens-remaining": "0"} for name in names):
        secs = wait_secs(headers, NOW)
        assert secs is None or 0 <= secs <= LONGEST_SECS


# Keys.


@pytest.mark.parametrize(
    "text",
    [
        "key=abcdef123456, again abcdef123456.",
        "Incorrect API key provided: sk-proj-99887766554433",
        "{'authorization': 'Bearer something-else'}",
        "gsk_aaaabbbbcccc and hf_ddddeeeeffff",
    ],
)
def test_keys_are_hidden(text: str) -> None:
    shown = Redactor(["abcdef123456", None, ""])(text)
    assert HIDDEN in shown
    for part in ("abcdef123456", "99887766554433", "something-else", "aaaabbbb", "ddddeeee"):
        assert part not in shown


def test_one_key_may_begin_with_another_and_short_words_stay() -> None:
    redact = Redactor(["secret-key", "secret-key-of-mine", "sink"])
    assert redact("secret-key-of-mine at the sink") == f"{HIDDEN} at the sink"
    assert redact("a desk-lamp, a task-list-of-mine") == "a desk-lamp, a task-list-of-mine"


def test_variables_that_are_named_like_a_key_are_secrets() -> None:
    keys = {"OPENAI_API_KEY": "one-1", "MY_TOKEN": " two-2 "}
    others = {"HOME": "h-1", "A_KEY": "", "B_KEY": "default", "C_KEY": "/etc/key-1"}
    assert environment_secrets(keys | others) == ("one-1", "two-2")


@pytest.mark.parametrize("config", [openai.Config, anthropic.Config])
def test_a_key_pasted_where_a_variable_is_named_is_refused_and_not_shown(config: Any) -> None:
    for pasted in ("sk-abcdef123456", "abcdef123456"):
        with pytest.raises(ValidationError) as caught:
            config(model="m", api_key_env=pasted)
        _key, message = explain(caught.value.errors()[0], {"api_key_env": pasted}, config)
        assert "name of an environment variable" in message
        assert pasted not in message


@pytest.mark.parametrize(
    "address", ["localhost:8000", "ftp://a", "http://", "http://user:word@host/v1", "http://a:99999", "x"]
)
def test_addresses_that_are_none(address: str) -> None:
    with pytest.raises(ValidationError, match="expected an address like"):
        openai.Config(model="m", base_url=address)


# What is missing on this machine.


def test_a_missing_package_is_said_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name in ("openai", "anthropic", "llm"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.setattr("dssmsg.llm.options.find_spec", lambda name: None)
    context = SimpleNamespace(base_dir=Path("/"), rng=np.random.default_rng(0), timeout_secs=1, log=None)
    for name, module, factory in (
        ("openai", openai, openai.OpenAiLlm),
        ("anthropic", anthropic, anthropic.AnthropicLlm),
        ("llm", llm, llm.LibraryLlm),
    ):
        config = module.Config(model="m")
        hint = rf"pip install 'dssmsg\[{name}\]'"
        with pytest.raises(ConfigError, match=hint) as caught:
            factory(config, context)
        assert caught.value.key == ".use"
        assert re.search(hint, config.problems(Path("/"), None)[0])


def test_problems_name_the_key_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    assert openai.Config(model="m").problems(tmp_path, None) == [
        "api_key_env: no key: variable OPENAI_API_KEY is not set or empty"
    ]
    assert openai.Config(model="m", base_url="http://localhost:1/v1").problems(tmp_path, None) == []
    (found,) = openai.Config(model="m", api_key_file="k").problems(tmp_path, None)
    assert found.startswith("api_key_file: ")
    assert str(tmp_path / "k") in found
    monkeypatch.setenv("OPENAI_API_KEY", "abc123")
    assert openai.Config(model="m").problems(tmp_path, None) == []


# Time.


def test_a_call_that_takes_too_long_is_left_behind() -> None:
    waiting = threading.Event()
    with pytest.raises(ProviderFault, match=r"no answer within 0.05 s") as caught:
        call_within(0.05, lambda: Reply("late") if waiting.wait(10) else Reply(""))
    waiting.set()
    assert caught.value.retry
    with pytest.raises(ZeroDivisionError):
        call_within(5, lambda: Reply(str(1 // 0)))
    assert call_within(5, lambda: Reply("x")).text == "x"


# Schemas on the wire.


def keywords(schema: Any) -> set[str]:
    """Every key of a schema that is not the name of a property."""
    if isinstance(schema, list):
        return set().union(*map(keywords, schema))
    if not isinstance(schema, dict):
        return set()
    found = set(schema)
    for key, value in schema.items():
        parts = value.values() if key == "properties" else [value]
        found |= set().union(*map(keywords, parts))
    return found


@pytest.mark.parametrize("schema", [TARGET_GRAPH_SCHEMA, DYNAMIC_ATTRIBUTE_SCHEMA])
def test_what_servers_are_sent_is_what_they_enforce(schema: Any) -> None:
    strict = strict_schema(schema)
    assert strict is not None
    allowed = {"type", "enum", "description", "properties", "required", "additionalProperties", "items"}
    assert keywords(json.loads(json.dumps(strict))) <= allowed
    assert strict["required"] == list(schema["properties"])
    assert "x-index-of" not in schema_words(schema)
    assert schema["required"][0] in schema_words(schema)


def test_limits_become_words_and_every_property_is_asked_for() -> None:
    strict = strict_schema(TARGET_GRAPH_SCHEMA)
    assert strict is not None
    nodes = strict["properties"]["nodes"]
    assert nodes["description"] == "at least 1 items, at most 20 items"
    assert nodes["items"]["required"] == ["label", "attributes"]
    assert "an index of nodes" in strict["properties"]["core"]["description"]
    assert strict["properties"]["kind"] == {"enum": ["explicit", "implicit"], "type": "string"}


@pytest.mark.parametrize(
    "schema",
    [
        {"type": "object"},
        {"type": "object", "properties": {"a": {"type": "object"}}, "additionalProperties": False},
        {"type": "array", "items": {"type": "object"}},
    ],
)
def test_what_cannot_be_enforced_is_said_in_words(schema: Any) -> None:
    assert strict_schema(schema) is None


# Answers.


@pytest.mark.parametrize(
    "text",
    [
        '{"a": 1}',
        '```json\n{"a": 1}\n```',
        'Sure:\n```\n{"a": 1}\n```\nThat is {all}.',
        'Here it is: {"a": 1}. Good luck!',
        '<think>maybe a sink</think>\n{"a": 1}',
    ],
)
def test_an_object_is_found_in_what_stands_around_it(text: str) -> None:
    assert parse_answer(text, {"type": "object"}) == {"a": 1}


def test_a_very_long_answer_is_not_read() -> None:
    with pytest.raises(ValueError, match="at most 200000 are read"):
        parse_answer('{"a": "' + "x" * 300_000 + '"}', {"type": "object"})


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["kind", "nodes", "edges", "core", "label", "x"]), inner, max_size=4
        )
    ),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=60) | VALUES.map(json.dumps) | VALUES.map(lambda value: f"So: {json.dumps(value)}."))
def test_any_answer_fits_or_is_refused(text: str) -> None:
    try:
        value = parse_answer(text, TARGET_GRAPH_SCHEMA)
    except ValueError:
        return
    assert not schema_faults(value, TARGET_GRAPH_SCHEMA)
    parse_target_graph(text, value)


@pytest.mark.parametrize("text", ["a\x00b", "\x1b[31m", "half \ud800"])
def test_control_characters_and_halves_are_faults(text: str) -> None:
    assert "control character or half" in schema_faults({"a": text}, {"properties": {"a": {}}})[0]


def test_an_index_is_held_against_its_list() -> None:
    schema = {"properties": {"of": {"type": "array", "items": {"type": "integer", "x-index-of": "nodes"}}}}
    assert schema_faults({"nodes": ["a", "b"], "of": [0, 1]}, schema) == []
    (fault,) = schema_faults({"nodes": ["a", "b"], "of": [0, 2]}, schema)
    assert fault == "answer.of[1]: 2 is no index of nodes, there are 2 (counted from 0)"
    assert schema_faults({"nodes": "x", "of": [5]}, schema) == []


def test_every_option_is_described_in_a_line() -> None:
    for config in (RemoteOptions, openai.Config, anthropic.Config, llm.Config):
        for name, field in config.model_fields.items():
            assert field.description, name
            assert len(field.description) <= 100, name
