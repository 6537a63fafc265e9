"""Sentences that only say what somebody wants: what serves it (paper III-C, implicit queries).

A row is a sentence, the core that serves it and its company. All sentences are our own, written while the
tables were; held-out ones are kept elsewhere.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dssmsg.lexicon.tables import load_tables
from dssmsg.lexicon.target import NoTarget, Targets

SENTENCES = [
    ("something to sit on near the piano", "chair, piano, table"),
    ("something I can sit on next to the desk", "chair, desk, table"),
    ("where the trash goes", "trash can"),
    ("the place to sleep", "bed, nightstand, lamp"),
    ("a spot with a lamp for reading", "armchair, lamp, bookcase"),
    ("a place to sit down and put on my shoes", "shoes, bench, doormat"),
    ("where can I put the milk?", "fridge, kitchen cabinet, oven"),
    ("where should dirty plates go?", "dishwasher, sink, kitchen cabinet"),
    ("where do I put away clean plates?", "kitchen cabinet, sink, wall cabinet"),
    ("a place to dry wet hair", "towel, towel rack, washbasin"),
    ("I'm sleepy", "bed, nightstand, lamp"),
    ("I'm sweaty after the gym", "shower, washbasin, toilet"),
    ("my hair is a mess", "mirror, washbasin"),
    ("there's no light in here", "lamp"),
    ("the baby is crying and tired", "crib, teddy bear"),
    ("I want to put my feet up", "pouf, armchair, sofa"),
    ("I want to have a chat over coffee with a friend", "sofa, coffee table, armchair"),
    ("Where could I sit and watch the football?", "tv, tv stand, sofa"),
    ("a place to do office work", "desk, office chair, laptop, lamp"),
    ("where would I go to brush my hair?", "mirror, washbasin"),
    ("I want to hear some Mozart", "stereo, speaker"),
    ("we want to eat pizza together", "table, chair, chair, chair"),
    ("take me to where I can make breakfast", "oven, kitchen cabinet, sink, fridge"),
    ("Take me to where the food is kept", "fridge, kitchen cabinet, oven"),
    ("the place where clothes are washed", "washing machine, tumble dryer, laundry basket, drying rack"),
    ("show me the place for cooking", "oven, kitchen cabinet, sink, fridge"),
    ("find a good place for a nap", "bed, nightstand, lamp"),
    ("I need a place to wash a muddy dog", "bathtub, washbasin, toilet"),
    ("where can I see myself from head to toe", "mirror, washbasin"),
    ("I want to sit by the window with a cup of tea", "chair, window, cup, table"),
    ("I would like to eat at the table", "table, chair, chair, chair"),
    ("I want to write something at the desk", "desk, office chair, laptop, lamp"),
    ("I want to know the time", "clock"),
    ("a place to set down a hot cup of tea while sitting on the sofa", "coffee table, sofa, rug"),
    ("a dark quiet place to sleep", "bed, nightstand, lamp"),
    ("find me a place suitable for washing up", "sink, oven, fridge, kitchen cabinet"),
    ("I want to wash my hands", "washbasin, mirror, toilet"),
    ("somewhere to read quietly", "armchair, bookcase, lamp"),
    ("a place suitable for reading", "armchair, bookcase, lamp"),
    ("a bright place suitable for working", "desk, office chair, laptop, lamp"),
    ("somewhere to lie down and sleep", "bed, nightstand, lamp"),
    ("I'm tired", "bed, nightstand, lamp"),
    ("where can I cook dinner?", "oven, kitchen cabinet, sink, fridge"),
    ("a place to keep the milk cold", "fridge, kitchen cabinet, oven"),
    ("I want to watch a film", "tv, tv stand, sofa"),
    ("somewhere I can do my homework", "desk, office chair, laptop, lamp"),
    ("a place to sit with friends and chat", "sofa, coffee table, armchair"),
    ("where should I throw away this wrapper?", "trash can"),
    ("I need to relieve myself", "toilet, washbasin, toilet paper"),
    ("where can I brush my teeth", "washbasin, mirror, toilet"),
    ("a spot to take a hot bath", "bathtub, washbasin, toilet"),
    ("where do I wash my clothes?", "washing machine, tumble dryer, laundry basket, drying rack"),
    ("somewhere to hang my coat", "wardrobe, bed, dresser"),
    ("I'd like to play some Chopin", "piano, piano bench"),
    ("a place to eat with my family", "table, chair, chair, chair"),
    ("where can I warm up my leftovers", "microwave, kitchen cabinet, fridge"),
    ("I want to make coffee", "coffee maker, kitchen cabinet, mug"),
    ("I'm thirsty", "fridge, bottle, sink"),
    ("I am hungry", "fridge, kitchen cabinet, oven"),
    ("it is too dark to read here", "lamp"),
    (
        "my clothes are dirty and must be cleaned",
        "washing machine, tumble dryer, laundry basket, drying rack",
    ),
    ("wash the dishes", "sink, oven, fridge, kitchen cabinet"),
    ("a place to check how I look", "mirror, washbasin"),
    ("something to drink from on the table", "mug, table, kitchen cabinet"),
    ("I want to read near the window", "armchair, window, bookcase, lamp"),
    ("take me somewhere I can relax", "sofa, coffee table, armchair"),
    ("a quiet corner for reading with a lamp", "armchair, lamp, bookcase"),
    ("somewhere to charge my phone", "phone"),
    ("a place to put my shoes on", "shoes, bench, doormat"),
    ("take me to the kitchen", "oven, fridge, kitchen cabinet, sink"),
    ("the living room", "sofa, tv, coffee table"),
    ("a place to store winter coats", "wardrobe, bed, dresser"),
    ("I want to listen to music", "stereo, speaker"),
    ("I'm cold", "radiator"),
    ("what time is it?", "clock"),
    ("where can I check the time", "clock"),
    ("I want to print a document", "printer, desk, computer"),
    ("I have to call my mother", "phone, table"),
    ("somewhere soft to sit", "sofa, coffee table, armchair"),
    ("a place to get dressed", "wardrobe, bed, dresser"),
    ("I need a nap", "bed, nightstand, lamp"),
    ("the place where we eat", "table, chair, chair, chair"),
    ("somewhere to put these flowers", "vase, table"),
    ("where the kids can play with toys", "teddy bear, rug"),
    ("I want to heat up some soup", "microwave, kitchen cabinet, fridge"),
    ("a place for baking a cake", "oven, kitchen cabinet, sink, fridge"),
    ("I'd like to dry my hands", "towel, towel rack, washbasin"),
    ("a good spot for writing a letter", "desk, office chair, laptop, lamp"),
    ("I want to shave", "washbasin, mirror, toilet"),
    ("I'm dirty and need a shower", "shower, washbasin, toilet"),
    ("somewhere to store leftovers", "fridge, kitchen cabinet, oven"),
    ("a place to do the laundry", "washing machine, tumble dryer, laundry basket, drying rack"),
    ("somewhere to sit in the kitchen", "chair, table, oven, fridge"),
    ("Where do I get a glass of water?", "sink, oven, fridge, kitchen cabinet"),
    ("Somewhere comfy to lounge about on a Sunday afternoon", "sofa, coffee table, armchair, cushion"),
    ("I've got muddy boots, where should they go", "doormat, shoes"),
    ("a spot where I could hang my wet towel", "towel rack, washbasin, bathtub"),
    ("I spilled crumbs on the floor", "broom"),
    ("I need to look up something online", "computer, desk, office chair"),
    ("Show me where the toddler naps", "crib, teddy bear"),
    ("a place for my guests to spend the night", "bed, nightstand, lamp"),
    ("Where can I put down my suitcase and unpack my shirts?", "wardrobe, bed, dresser"),
    ("I feel like playing a sonata", "piano, piano bench"),
    ("Where does one dispose of old batteries?", "trash can"),
    ("It's freezing in here", "radiator"),
    ("Where can I rinse this cup?", "sink, oven, fridge, kitchen cabinet"),
    ("where would I iron my blouse", "ironing board, iron, washing machine"),
    ("Where can we all have Christmas dinner together?", "table, chair, chair, chair"),
    ("I'd love to soak my aching muscles", "bathtub, washbasin, toilet"),
    ("Could you bring me to where I can get myself a cold beer?", "fridge, kitchen cabinet, oven"),
    ("Somewhere to catch the evening news", "tv, tv stand, sofa"),
    ("Where can I check whether my tie is straight?", "mirror, washbasin"),
    ("a place where I can type up my thesis", "desk, office chair, laptop, lamp"),
    ("I must find out how late it is", "clock"),
    ("somewhere to keep my jewellery safe", "safe"),
    ("I want to water the plants", "plant"),
    ("I want to practise my guitar chords", "guitar"),
    ("somewhere for the dog to sleep", "pet bed"),
    ("where can I find something to read before bed", "bookcase, book"),
    ("My hands are greasy", "washbasin, mirror, toilet"),
    ("I need to get ready for a night out and do my make-up", "dressing table, mirror"),
    ("a place to unwind after work", "sofa, coffee table, armchair"),
    ("somewhere to prepare vegetables for dinner", "kitchen cabinet, sink, oven"),
    ("take me where the cooking happens", "oven, kitchen cabinet, sink, fridge"),
    ("where people sit down for meals", "table, chair, chair, chair"),
    ("where someone would shower in the morning", "shower, washbasin, toilet"),
    ("the spot for storing clean towels", "cabinet, washbasin"),
    ("a place that is good for taking a phone call", "phone, table"),
    ("I could use some light over here", "lamp"),
    ("where can I put my book and glasses before going to sleep", "nightstand, bed, lamp"),
    ("a cosy place for two people to watch a movie", "tv, tv stand, sofa, rug"),
    ("I need to hang a picture high up on the wall and cannot reach", "step ladder"),
    ("where might I store my winter jumper", "wardrobe, bed, dresser"),
    ("I want to have a snack", "fridge, kitchen cabinet, oven"),
    ("a place where I can tie my shoelaces", "shoes, bench, doormat"),
    ("a place to wait while putting on shoes", "shoes, bench, doormat"),
    ("let me see myself", "mirror, washbasin"),
    ("somewhere to take off my coat and shoes", "shoes, bench, doormat"),
    ("I want to make myself a smoothie", "mixer, kitchen cabinet"),
    ("Where can I boil an egg?", "oven, kitchen cabinet, sink, fridge"),
    ("I want to relax with a good novel", "armchair, book, bookcase, lamp"),
    ("I want to bake a birthday cake", "oven, kitchen cabinet, sink, fridge"),
    ("Where do we keep the frozen peas?", "freezer, fridge"),
    ("my back hurts and I need to lie down", "bed, nightstand, lamp"),
    ("the kids need a bath", "bathtub, washbasin, toilet"),
    ("Can you go to where the dirty dishes go?", "dishwasher, sink, kitchen cabinet"),
    ("I would like to freshen up before dinner", "washbasin, mirror, toilet"),
    ("I want to call someone", "phone, table"),
    ("I need to toss this banana peel", "trash can"),
    ("somewhere quiet to work without distraction", "desk, office chair, laptop, lamp"),
    ("somewhere to stand my bag while I put on my shoes", "shoes, bench, doormat"),
    ("go back to the kitchen", "oven, fridge, kitchen cabinet, sink"),
    ("find a place where I can put my dirty cup", "dishwasher, sink, kitchen cabinet"),
    ("I want a midnight snack", "fridge, kitchen cabinet, oven"),
    ("place where someone could practise an instrument", "piano, piano bench"),
    ("a place where guests can leave their coats", "wardrobe, bed, dresser"),
    ("I'd like to wash up", "sink, oven, fridge, kitchen cabinet"),
    ("wash my face", "washbasin, mirror, toilet"),
    ("I want to look good for my date", "mirror, washbasin"),
    ("I would like you to go to the place where I usually watch TV", "tv, tv stand, sofa"),
    ("somewhere to sit that is not the sofa", "chair, table"),
    ("somewhere to sit other than the sofa", "chair, table"),
    ("I don't want to sit on the sofa", "chair, table"),
    ("I want to sit but I don't want to sit on the sofa", "chair, table"),
    ("somewhere to sit, but not on the sofa", "chair, table"),
    ("anything but the sofa to sit on", "chair, table"),
    ("somewhere to sit that is not a chair", "sofa"),
    ("somewhere to sit except the chair", "sofa"),
    ("I'd rather not sit on a chair", "sofa"),
    ("somewhere to sleep that is not the bed", "sofa"),
    ("somewhere to sit without a chair", "sofa, chair"),
    ("somewhere to eat without chairs", "table, chair"),
    ("I don't want to sit near the window", "chair, window, table"),
    ("the kitchen without an oven", "fridge, kitchen cabinet, sink"),
]
NAMED = [
    ("I want to sit on the sofa", "sofa"),
    ("I want to take a nap on the couch", "sofa"),
    ("a place to work on my laptop", "laptop"),
    ("I want to read in the bed", "bed"),
    ("I need to charge my laptop", "laptop"),
]


@pytest.fixture(scope="module")
def targets():
    return Targets(load_tables())


@pytest.mark.parametrize(("sentence", "expected"), SENTENCES)
def test_what_serves_a_wish(targets, sentence, expected):
    graph = targets.of(sentence)
    assert ", ".join(node["label"] for node in graph["nodes"]) == expected
    assert (graph["kind"], graph["core"]) == ("implicit", 0)
    joined = {index for edge in graph["edges"] for index in (edge["source"], edge["target"])}
    assert joined == set(range(len(graph["nodes"]))) or len(graph["nodes"]) == 1


@pytest.mark.parametrize(("sentence", "core"), NAMED)
def test_what_is_named_for_a_purpose_is_meant(targets, sentence, core):
    graph = targets.of(sentence)
    assert (graph["nodes"][0]["label"], graph["kind"]) == (core, "explicit")


def test_the_document_tells_the_truth(targets):
    text = (Path(__file__).parents[1] / "docs" / "lexicon.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    told = {row[0]: row[1].split(" (")[0] for row in rows if row[0] != "sentence"}
    assert len(told) == 16
    for sentence, things in told.items():
        core = targets.of(sentence)["nodes"][0]
        described = f" [{', '.join(core['attributes'])}]" if core["attributes"] else ""
        assert f"{things.strip()}, ".startswith(f"{core['label']}{described}, "), sentence


def core_of(targets, sentence):
    try:
        return targets.of(sentence)["nodes"][0]["label"]
    except NoTarget:
        return None


def test_company_tells_the_kitchen_sink_from_the_washbasin(targets):
    def company(sentence):
        return {node["label"] for node in targets.of(sentence)["nodes"]}

    for sentence in ("somewhere to wash the dishes", "the kitchen sink", "the sink", "rinse the plates"):
        assert "sink" in company(sentence)
        assert "oven" in company(sentence)
        assert not {"toilet", "washbasin"} & company(sentence)
    for sentence in ("brush my teeth", "the bathroom sink", "the washbasin", "the sink in the bathroom"):
        assert {"washbasin", "toilet"} <= company(sentence)
        assert not {"oven", "sink"} & company(sentence)


def test_every_need_and_room_of_the_tables_is_reached(targets):
    tables = load_tables()
    for room in tables.rooms:
        assert targets.of(f"take me to the {room}")["nodes"][0]["label"] == tables.rooms[room].landmarks[0]
    for need in tables.needs:
        wordings = [" ".join(word.split("|")[0] for word in phrase.split()) for phrase in need.says]
        assert any(core_of(targets, f"somewhere to {wording}") == need.core for wording in wordings), need


def test_tables_name_only_what_they_know():
    tables = load_tables()
    known = set(tables.labels)
    for need in tables.needs:
        for entry in (need.core, *need.with_, *need.or_):
            label, _, relation = entry.rpartition(" ")
            assert entry in known or (label in known and relation in tables.relations), entry
    for room in tables.rooms.values():
        assert {*room.landmarks, *room.says.values()} <= known
    for companions in tables.qualities.values():
        assert set(companions) <= known
    for label in tables.labels.values():
        assert set(label.company) <= known
    for rule in tables.surroundings:
        assert {rule.label, *rule.near} <= known


class Meaning:
    """A text encoder with three directions: light, music, anything else."""

    space, dimension = "test/3", 3

    def encode_text(self, texts):
        rows = [self._row(text.lower()) for text in texts]
        return np.array(rows, np.float32).reshape(len(texts), 3)

    encode_labels = encode_text

    def encode_crops(self, crops):
        return None

    @staticmethod
    def _row(text):
        if "gloom" in text or "when it is dark" in text:
            return (1, 0, 0)
        if "serenade" in text or "on the keys" in text:
            return (0, 1, 0)
        return (0, 0, 1) if "qwertz" not in text else (-0.6, -0.6, -0.5291503)


def test_where_no_wording_fits_the_encoder_helps():
    helped, alone = Targets(load_tables(), Meaning()), Targets(load_tables())
    for sentence, core in (("gloom everywhere", "lamp"), ("serenade us", "piano")):
        graph = helped.of(sentence)
        assert (graph["nodes"][0]["label"], graph["kind"]) == (core, "implicit")
        with pytest.raises(NoTarget, match="no known object, purpose or room"):
            alone.of(sentence)
    with pytest.raises(NoTarget):
        helped.of("qwertz")
