"""The offline LLM plug-ins, requests and answers; and the rule `errors` that reads what failed."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from dssmsg_plugins.diagnosis.errors import Config as ErrorsConfig
from dssmsg_plugins.diagnosis.errors import ErrorsRule
from dssmsg_plugins.llm import recorded, scripted
from pydantic import ValidationError

from dssmsg.checks import check_answer, check_findings
from dssmsg.errors import ConfigError, InputError, PluginError
from dssmsg.interfaces.llm import Message
from dssmsg.llm_requests import parse_answer, request_hash, schema_faults
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request
from dssmsg.target_graph import parse_target_graph

ATTRIBUTE_SCHEMA = {
    "type": "object",
    "required": ["dynamic_attribute"],
    "properties": {"dynamic_attribute": {"type": "number", "minimum": 0, "maximum": 1}},
}
SINK = {"kind": "explicit", "nodes": [{"label": "sink"}], "edges": [], "core": 0}


def context(base=Path("/")):
    return SimpleNamespace(base_dir=base)


def understand(llm, sentence):
    answer = check_answer(llm.complete("target_graph", target_graph_request(sentence), TARGET_GRAPH_SCHEMA))
    target = parse_target_graph(sentence, answer.value)
    edges = [(target.nodes[e.source].label, e.relation, target.nodes[e.target].label) for e in target.edges]
    return target, [node.label for node in target.nodes], edges


# Scripted answers.


def scripted_llm(base=Path("/"), **options):
    return scripted.Scripted(scripted.Config(**options), context(base))


def test_scripted_answers_come_in_order_and_the_last_is_repeated():
    bed = {**SINK, "nodes": [{"label": "bed"}]}
    llm = scripted_llm(answers={"target_graph": [SINK, json.dumps(bed)]})
    assert [understand(llm, "anything")[1] for _ in range(3)] == [["sink"], ["bed"], ["bed"]]


def test_scripted_answers_can_run_out():
    llm = scripted_llm(answers={"target_graph": [SINK]}, repeat=False)
    understand(llm, "one")
    with pytest.raises(PluginError, match="no answer left for target_graph, 1 were given"):
        understand(llm, "two")
    with pytest.raises(PluginError, match="no answer left for dynamic_attribute, 0"):
        llm.complete("dynamic_attribute", [], ATTRIBUTE_SCHEMA)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("Sure! Here is your graph:", "no JSON"),
        ('{"kind": "explicit", "nodes": [', "no JSON"),
        ("[1, 2]", "expected object, got list"),
        ({**SINK, "kind": "maybe"}, "expected one of explicit, implicit"),
        ({**SINK, "core": -1}, "expected at least 0"),
        ({**SINK, "nodes": []}, "at least 1"),
        ({**SINK, "nodes": [{"label": "x"}] * 1000}, "at most 20, got 1000"),
        ({**SINK, "extra": 1}, "'extra' is not known"),
        ('{"core": NaN}', "NaN is no JSON"),
    ],
)
def test_answers_of_a_confused_model_fail(answer, words):
    with pytest.raises(PluginError, match=words):
        understand(scripted_llm(answers={"target_graph": [answer]}), "x")


def test_scripted_answers_from_a_file(tmp_path):
    (tmp_path / "answers.yaml").write_text(yaml.safe_dump({"target_graph": [SINK]}))
    assert understand(scripted_llm(tmp_path, file="answers.yaml"), "x")[1] == ["sink"]
    for text, words in (
        ("target_graph: sink", "target_graph"),
        ("target_graph: []\ntarget_graph: []", "written twice"),
        ("[", "not valid YAML"),
        ("", "holds no answers"),
    ):
        (tmp_path / "answers.yaml").write_text(text)
        with pytest.raises(ConfigError, match=words) as caught:
            scripted_llm(tmp_path, file="answers.yaml")
        assert (caught.value.file, caught.value.key) == (str(tmp_path / "answers.yaml"), ".file")


@pytest.mark.parametrize("options", [{}, {"answers": {"target_graph": [SINK]}, "file": "x.yaml"}])
def test_a_script_has_one_origin(options):
    with pytest.raises(ValidationError, match="either answers or file"):
        scripted.Config(**options)


# Recorded answers.


def recorded_llm(monkeypatch, calls):
    class FakeRecording:
        path = Path("a.rrd")

        @classmethod
        def open(cls, path):
            return cls()

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def llm_calls(self):
            return calls

    monkeypatch.setattr("dssmsg.recording.reader.Recording", FakeRecording)
    return recorded.Recorded(recorded.Config(recording="a.rrd"), context())


def call(sentence, answer, ok=True):
    key = request_hash("target_graph", target_graph_request(sentence), TARGET_GRAPH_SCHEMA)
    return {"request_hash": key, "answer": answer, "ok": ok, "tokens": 7}


def test_recorded_answers_are_found_by_their_request(monkeypatch):
    bed = json.dumps({**SINK, "nodes": [{"label": "bed"}]})
    calls = [call("a", "broken", ok=False), call("a", json.dumps(SINK)), call("b", bed)]
    llm = recorded_llm(monkeypatch, calls)
    assert understand(llm, "b")[1] == ["bed"]
    assert understand(llm, "a")[1] == ["sink"]
    with pytest.raises(PluginError, match="holds no answer to this target_graph request; it has 2 answers"):
        understand(llm, "c")


def test_the_same_question_gets_its_answers_in_their_order(monkeypatch):
    beds = [json.dumps({**SINK, "nodes": [{"label": name}]}) for name in ("bed", "sofa")]
    llm = recorded_llm(monkeypatch, [call("a", beds[0]), call("b", beds[1]), call("a", beds[1])])
    assert [understand(llm, "a")[1] for _ in range(3)] == [["bed"], ["sofa"], ["sofa"]]
    assert understand(llm, "b")[1] == ["sofa"]


def test_recorded_needs_a_recording(tmp_path):
    with pytest.raises(InputError):
        recorded.Recorded(recorded.Config(recording="none.rrd"), context(tmp_path))


def test_doctor_is_told_of_files_that_are_missing(tmp_path):
    configs = [recorded.Config(recording="a.rrd"), scripted.Config(file="a.yaml")]
    found = [one.problems(tmp_path, None) for one in configs]
    assert found == [
        [f"recording: {tmp_path / 'a.rrd'}: no such file or folder"],
        [f"file: {tmp_path / 'a.yaml'}: no such file"],
    ]
    for name in ("a.rrd", "a.yaml"):
        (tmp_path / name).touch()
    assert [one.problems(tmp_path, None) for one in configs] == [[], []]
    assert scripted.Config(answers={"target_graph": [SINK]}).problems(tmp_path, None) == []


# Requests and schemas.


def test_a_request_has_one_hash():
    messages = (Message("system", "do"), Message("user", "a ß b"))
    key = request_hash("r", messages, {"type": "object", "required": ["a"]})
    assert key == request_hash("r", list(messages), {"required": ["a"], "type": "object"})
    assert len(key) == 64
    others = [
        request_hash("q", messages, {"type": "object", "required": ["a"]}),
        request_hash("r", messages[1:], {"type": "object", "required": ["a"]}),
        request_hash("r", messages, {"type": "object"}),
        request_hash("r", (Message("user", "do"), messages[1]), {"type": "object", "required": ["a"]}),
    ]
    assert len({key, *others}) == 5


@pytest.mark.parametrize(
    ("value", "schema", "fault"),
    [
        (True, {"type": "integer"}, "expected integer, got bool"),
        (1, {"type": "boolean"}, "expected boolean"),
        (1.5, {"type": "integer"}, "expected integer"),
        (3, {"type": "number", "maximum": 2}, "at most 2"),
        ("", {"type": "string", "minLength": 1}, "at least 1"),
        ({}, {"required": ["a"]}, "a is missing"),
        ({"a": {"b": 1}}, {"properties": {"a": {"properties": {"b": {"type": "string"}}}}}, "answer.a.b"),
        ([1, "x"], {"type": "array", "items": {"type": "integer"}}, r"answer\[1\]"),
    ],
)
def test_schema_faults_say_where(value, schema, fault):
    import re

    (found,) = schema_faults(value, schema)
    assert re.search(fault, found)


def test_values_that_fit_have_no_faults():
    schema = {"type": "object", "properties": {"a": {"type": "number", "minimum": 0}, "b": {"type": "null"}}}
    assert schema_faults({"a": 1, "b": None, "c": "free"}, schema) == []
    assert parse_answer(' {"a": 0} ', schema) == {"a": 0}


def test_unknown_schema_keywords_are_not_passed_over():
    with pytest.raises(ValueError, match="oneOf"):
        schema_faults(1, {"oneOf": []})


def test_deep_nesting_is_an_answer_that_fails():
    with pytest.raises(ValueError, match="no JSON"):
        parse_answer("[" * 100_000, {})


# The rule `errors`.


def failure(frame, plugin, *, fatal=False, skipped="detect"):
    return {
        "frame": frame,
        "plugin": plugin,
        "message": f"boom at {frame}",
        "skipped": skipped,
        "fatal": fatal,
    }


def test_failures_become_findings_the_worst_first():
    errors = [failure(3, "perception/a"), failure(4, "llm/b"), failure(5, "perception/a")]
    errors.append(failure(9, "source/c", fatal=True, skipped=""))
    recording = SimpleNamespace(errors=lambda: errors, episodes=list)
    found = check_findings(ErrorsRule(ErrorsConfig(shown=1)).diagnose(recording, None))
    assert [(f.layer, f.frame) for f in found] == [("environment", 9), ("detector", 3), ("grounding", 4)]
    assert found[0].confidence == 1.0
    assert found[1].confidence == pytest.approx(0.25)
    assert found[1].summary == "perception/a failed 2 times and skipped work 2 times: boom at 3"
    assert found[1].events == ("frame 3: boom at 3",)


def test_findings_of_one_episode():
    errors = [failure(3, "llm/a"), failure(15, "llm/b"), failure(25, "llm/c")]
    episodes = [{"episode": 0, "frame": 10}, {"episode": 1, "frame": 20}]
    recording = SimpleNamespace(errors=lambda: errors, episodes=lambda: episodes)
    rule = ErrorsRule(ErrorsConfig())
    assert [f.frame for f in rule.diagnose(recording, 1)] == [15]
    assert [f.frame for f in rule.diagnose(recording, 0)] == [3]


def test_no_failures_no_findings():
    recording = SimpleNamespace(errors=list, episodes=list)
    assert ErrorsRule(ErrorsConfig()).diagnose(recording, None) == []
