"""The provider that stands on the `llm` library: its models, its plug-ins, its keys."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import llm
import llm_server as servers
import numpy as np
import pytest
from dssmsg_plugins.llm import llm as provider
from dssmsg_plugins.llm import scripted
from llm_server import LlmServer

from dssmsg.errors import ConfigError, PluginError
from dssmsg.interfaces.llm import Exchange
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request


class Echo(llm.Model):
    """A model of somebody's plug-in for the library; `script` holds what it says, or raises."""

    model_id = "dssmsg-echo"
    script: list[Any] = []  # noqa: RUF012 - the library builds the model, a test fills it
    asked: list[Any] = []  # noqa: RUF012

    class Options(llm.Options):
        loud: bool | None = None

    def execute(self, prompt: Any, stream: bool, response: Any, conversation: Any) -> Iterator[str]:
        self.asked.append(prompt)
        said = self.script.pop(0)
        if isinstance(said, Exception):
            raise said
        response.set_usage(input=30, output=12)
        yield said


class WithSchema(Echo):
    model_id = "dssmsg-echo-schema"
    supports_schema = True


class WithKey(Echo):
    model_id = "dssmsg-echo-key"
    needs_key = "dssmsg-echo"
    key_env_var = "DSSMSGECHO_API_KEY"


class Plugin:
    @llm.hookimpl
    def register_models(self, register: Any) -> None:
        for model in (Echo, WithSchema, WithKey):
            register(model())


@pytest.fixture(autouse=True)
def _library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("LLM_USER_PATH", str(tmp_path / "llm"))
    monkeypatch.delenv("DSSMSGECHO_API_KEY", raising=False)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setattr(Echo, "script", [])
    monkeypatch.setattr(Echo, "asked", [])
    plugin = Plugin()
    llm.plugins.load_plugins()
    llm.plugins.pm.register(plugin, "dssmsg-test")
    yield
    llm.plugins.pm.unregister(plugin)


def make(told: list[Exchange], model: str = "dssmsg-echo", **options: Any) -> provider.LibraryLlm:
    context = SimpleNamespace(
        base_dir=Path("/"),
        rng=np.random.default_rng(0),
        log=logging.getLogger("dssmsg.test"),
        build=lambda *_, **__: scripted.Scripted(
            scripted.Config(answers={"target_graph": [servers.SINK]}), SimpleNamespace()
        ),
        timeout_secs=10.0,
    )
    made = provider.LibraryLlm(
        provider.Config(model=model, **{"fallback": None, **options}), context, sleep=lambda _: None
    )
    made.tell_exchanges(told.append)
    return made


def ask(made: provider.LibraryLlm) -> Any:
    return made.complete("target_graph", target_graph_request("the sink"), TARGET_GRAPH_SCHEMA)


def test_a_model_of_a_plugin_of_the_library() -> None:
    told: list[Exchange] = []
    Echo.script[:] = ["```json\n" + json.dumps(servers.SINK) + "\n```"]
    answer = ask(make(told, options={"loud": True}))
    assert answer.value == servers.SINK
    (prompt,) = Echo.asked
    assert prompt.prompt == "the sink"
    assert "JSON schema" in prompt.system
    assert prompt.schema is None
    assert prompt.options.loud is True
    assert [(one.provider, one.tokens, one.error) for one in told] == [("llm", 42, "")]


def test_a_model_that_takes_schemas_gets_one() -> None:
    Echo.script[:] = [json.dumps(servers.SINK)]
    ask(make([], "dssmsg-echo-schema"))
    (prompt,) = Echo.asked
    assert prompt.schema["required"] == ["kind", "nodes", "edges", "core"]
    assert "JSON schema" not in prompt.system


def test_repair_in_one_text() -> None:
    told: list[Exchange] = []
    Echo.script[:] = ["no idea", json.dumps(servers.SINK)]
    assert ask(make(told)).value == servers.SINK
    text = Echo.asked[1].prompt
    assert text.index("the sink") < text.index("no idea") < text.index("cannot be used")
    assert [bool(one.error) for one in told] == [True, False]


def test_whatever_a_plugin_raises_ends_with_the_fallback() -> None:
    told: list[Exchange] = []
    Echo.script[:] = [RuntimeError("boom"), llm.ModelError("quota of sk-abcdef123456 is used up")]
    made = make(told, fallback={"use": "scripted"})
    for _ in range(2):
        assert ask(made).value == servers.SINK
    assert [one.fallback_for for one in told] == ["", "llm"] * 2
    assert "RuntimeError: boom" in told[0].error
    assert "sk-abcdef123456" not in told[2].error
    with pytest.raises(PluginError, match="plug-in llm/llm: "):
        ask(make([], rest_secs=0))


def test_a_long_answer_is_not_read_to_its_end() -> None:
    told: list[Exchange] = []
    Echo.script[:] = ["x" * 5000]
    with pytest.raises(PluginError, match="longer than 1000"):
        ask(make(told, max_answer_bytes=1000))


@pytest.mark.parametrize(
    ("model", "options", "words", "key"),
    [
        ("no-such-model", {}, "knows no model 'no-such-model'", ".model"),
        ("dssmsg-echo-key", {}, "llm keys set dssmsg-echo or set the variable DSSMSGECHO_API_KEY", ".model"),
        ("dssmsg-echo", {"options": {"quiet": 1}}, "quiet", ".options"),
    ],
)
def test_what_is_missing_is_named(model: str, options: Any, words: str, key: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        make([], model, **options)
    assert caught.value.key == key
    if key == ".model":
        (problem,) = provider.Config(model=model).problems(Path("/"), None)
        assert problem.startswith("model: ")
        assert words.split()[-1] in problem


def test_the_library_key_is_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DSSMSGECHO_API_KEY", "plain-word-key-77")
    told: list[Exchange] = []
    Echo.script[:] = [RuntimeError("bad key plain-word-key-77")]
    with pytest.raises(PluginError) as caught:
        ask(make(told, "dssmsg-echo-key"))
    assert "plain-word-key-77" not in str(caught.value) + told[0].error
    assert provider.Config(model="dssmsg-echo-key").problems(Path("/"), None) == []


def test_a_compatible_server_through_the_library(tmp_path: Path) -> None:
    """`extra-openai-models.yaml`, as the library documents it; the same server, the same ends."""
    with LlmServer(servers.prose, servers.good) as server:
        (tmp_path / "llm").mkdir()
        (tmp_path / "llm" / "extra-openai-models.yaml").write_text(
            f"- model_id: local\n  model_name: m\n  api_base: {server.address}/v1\n  can_stream: false\n"
        )
        told: list[Exchange] = []
        assert ask(make(told, "local")).value == servers.SINK
        assert [bool(one.error) for one in told] == [True, False]
        assert told[1].tokens == 42
    down: list[Exchange] = []
    with pytest.raises(PluginError, match="no connection"):
        ask(make(down, "local", retries=0))
