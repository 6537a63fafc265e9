"""llm/lexicon as the host gets it: roles, errors, tables of one's own, and what becomes of any text."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
from dssmsg_plugins.llm.lexicon import Config, Lexicon
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.checks import check_answer
from dssmsg.dynamic_attribute import DYNAMIC_ATTRIBUTE_SCHEMA, DynamicAttributes
from dssmsg.errors import ConfigError, NotUnderstood, PluginError
from dssmsg.interfaces.llm import Message
from dssmsg.mission.goal import TARGET_GRAPH_SCHEMA, target_graph_request
from dssmsg.target_graph import parse_target_graph


def lexicon(base=Path("/"), **options):
    return Lexicon(Config(**options), SimpleNamespace(base_dir=base, encoder=None))


@pytest.fixture(scope="module")
def words():
    return lexicon()


def understand(llm, sentence):
    answer = check_answer(llm.complete("target_graph", target_graph_request(sentence), TARGET_GRAPH_SCHEMA))
    assert json.loads(answer.text) == answer.value
    return parse_target_graph(sentence, answer.value)


def test_it_answers_both_roles(words):
    target = understand(words, "the red mug on the desk")
    assert [(node.label, node.attributes) for node in target.nodes] == [("mug", ("red",)), ("desk", ())]
    assert (target.kind, target.core, target.edges[0].relation) == ("explicit", 0, "on")
    estimate = DynamicAttributes(words).estimate("mug", (0.1, 0.1, 0.1), ["desk"])
    assert (estimate.value, estimate.source) == (1.0, "llm")


def test_only_the_last_user_message_counts(words):
    messages = [Message("user", "the sofa"), Message("assistant", "{}"), Message("user", "the bed")]
    answer = words.complete("target_graph", messages, TARGET_GRAPH_SCHEMA)
    assert answer.value["nodes"][0]["label"] == "bed"


def test_unknown_roles_are_refused(words):
    with pytest.raises(PluginError, match="target_graph and dynamic_attribute, not 'poem'"):
        words.complete("poem", [Message("user", "sofa")], {})


def test_an_answer_that_does_not_fit_the_schema_is_an_error(words):
    with pytest.raises(PluginError, match="does not fit its schema"):
        words.complete("target_graph", [Message("user", "sofa")], DYNAMIC_ATTRIBUTE_SCHEMA)


NONSENSE = [
    "",
    "   ",
    "???",
    "asdf qwer",
    "ich suche eine Katze",
    "the",
    "not",
    "and on with",
    "x" * 5000,
    "12",
]


@pytest.mark.parametrize("sentence", NONSENSE)
def test_what_says_nothing_gives_no_target_and_says_so(words, sentence):
    with pytest.raises(NotUnderstood, match=r"no (known )?object, purpose or room in") as caught:
        understand(words, sentence)
    assert len(str(caught.value)) < 200


VOCABULARY = re.findall(
    r"\S+",
    "a the my on under in next to near between and with without no not it that is was before where room place"
    " or but neither nor 2 anything"
    " somewhere to wash read sofa table mug kitchen red two three of for , glass orange iron shelves xyzzy I",
)


@settings(max_examples=300, deadline=None)
@given(st.one_of(st.text(max_size=200), st.lists(st.sampled_from(VOCABULARY), max_size=25).map(" ".join)))
def test_any_text_gives_a_target_or_none(words, sentence):
    try:
        target = understand(words, sentence)
    except PluginError:
        return
    assert 1 <= len(target.nodes) <= 20
    assert all(node.label for node in target.nodes)
    assert all(edge.source != edge.target for edge in target.edges)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=100), st.recursive(st.none() | st.text() | st.floats() | st.integers(), st.lists))
def test_any_question_about_movement_has_a_value(words, label, size):
    text = json.dumps({"label": label, "size_m": size, "around": [label, size]})
    for question in (text, label):
        answer = words.complete("dynamic_attribute", [Message("user", question)], DYNAMIC_ATTRIBUTE_SCHEMA)
        assert 0 <= answer.value["dynamic_attribute"] <= 1


# Tables of one's own.


def test_a_table_of_ones_own_extends_the_packaged_ones(tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "labels: {theremin: {also: [aetherphone], moves: 0.9}, mug: {moves: 0.2}}\n"
        "needs: [{says: [wave hands], about: playing without touching, core: theremin, with: [mug on]}]\n"
        "rooms: {boudoir: {landmarks: [dressing table]}}\n"
        "attributes: {shiny: [gleaming]}\n"
        "negations: {sans: with}\n"
    )
    mine = lexicon(tmp_path, tables=("mine.yaml",))
    target = understand(mine, "the gleaming aetherphone on the table")
    assert [(node.label, node.attributes) for node in target.nodes] == [
        ("theremin", ("shiny",)),
        ("table", ()),
    ]
    assert understand(mine, "a table sans aetherphone").edges[0].relation == "without"
    target = understand(mine, "somewhere to wave my hands about")
    assert ([node.label for node in target.nodes], target.kind) == (["theremin", "mug"], "implicit")
    assert understand(mine, "the boudoir").nodes[0].label == "dressing table"
    assert understand(mine, "the sofa").nodes[0].label == "sofa"
    attributes = DynamicAttributes(mine)
    assert attributes.of("theremin", (1, 1, 1), ()) == 0.9
    assert attributes.of("mug", (1, 1, 1), ()) == 0.2
    assert attributes.of("cup", (1, 1, 1), ()) == 1.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("labels: [sofa]", "labels"),
        ("labels: {sofa: {moves: 3}}", "labels.sofa.moves"),
        ("labels: {sofa: {move: 0.3}}", "labels.sofa.move"),
        ("label: {sofa: {}}", "label"),
        ("needs: [{says: [sit], core: sofa}]", "needs.0.about"),
        ("rooms: {den: {}}", "rooms.den.landmarks"),
        ("negations: [sans]", "negations: .*the relation that it denies"),
        ("negations: {sans: wiht}", "negations.sans: no relation 'wiht'"),
        ("- sofa", "a list of 1"),
        ("labels: {sofa: {", "not valid YAML"),
        ("labels: {sofa: {}, sofa: {}}", "written twice"),
        ("labels: " + "[" * 3000, "nested"),
    ],
)
def test_broken_tables_are_named(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words) as caught:
        lexicon(tmp_path, tables=("mine.yaml",))
    assert (caught.value.file, caught.value.key) == (str(path), ".tables")


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(ConfigError, match="no such file") as caught:
        lexicon(tmp_path, tables=("none.yaml",))
    assert caught.value.key == ".tables"  # the host puts the slot before it
