"""How readily things move, by the table: levels, sizes, surroundings, strangers (paper III-A, III-B)."""

from __future__ import annotations

import json
from importlib import resources

import numpy as np
import pytest
import yaml

from dssmsg.dynamic_attribute import NEUTRAL, dynamic_attribute_request, level
from dssmsg.lexicon.movement import Movement
from dssmsg.lexicon.tables import load_tables
from dssmsg.lexicon.words import singular, stem, tokens

DATA = resources.files("dssmsg") / "data"
L1 = "cup mug chair laptop handbag backpack bottle book phone remote_control shoes suitcase cushion box bowl"
L2 = "stool plant lamp floor_lamp trash_can vase pouf bench coffee_table fan armchair picture toaster"
L3 = (
    "bathtub bed wardrobe sofa sink washbasin counter kitchen_island oven fridge toilet bookcase desk table"
    " piano mirror radiator dresser tv dishwasher washing_machine cabinet"
)


@pytest.fixture(scope="module")
def movement():
    return Movement(load_tables())


@pytest.mark.parametrize(("labels", "expected"), [(L1, 1), (L2, 2), (L3, 3)])
def test_levels_are_the_papers(movement, labels, expected):
    found = {label: level(movement.of(label)) for label in labels.split()}
    assert found == dict.fromkeys(found, expected)


def test_everything_people_move_is_watched(movement):
    """L3 is never compared: what a scene lets people move must not be there."""
    furniture = yaml.safe_load((DATA / "furniture" / "categories.yaml").read_text())
    for name, entry in furniture.items():
        label = entry.get("label", name)
        assert tuple(tokens(label)) in movement._moves
        if entry.get("movable"):
            assert level(movement.of(label)) < 3, label


def test_all_labels_of_the_detectors_are_known(movement):
    names = [name for name in (DATA / "coco_names.txt").read_text().splitlines() if name]
    assert len(names) == 80
    unknown = [name for name in names if movement._find(tokens(name)) is None]
    assert unknown == []


def test_no_word_stands_for_two_things():
    tables = load_tables()
    words = [word for name, label in tables.labels.items() for word in (name, *label.also, *label.like)]
    assert len(words) == len(set(words))


def test_other_names_plurals_and_compounds(movement):
    assert movement.of("couch") == movement.of("sofa") == movement.of("Sofas")
    assert movement.of("blue coffee mugs") == movement.of("mug")
    assert movement.of("violin") == movement.of("guitar")
    assert movement.of("dining_table") == movement.of("table")


def test_the_surroundings_tell_things_of_one_name_apart(movement):
    assert level(movement.of("speaker", (0.2, 0.2, 0.3), ["desk"])) == 2
    assert level(movement.of("speaker", (0.2, 0.2, 0.3), ["television", "sofa"])) == 3
    assert movement.of("mirror", (), ["bathroom sink"]) < movement.of("mirror", (), ["bed"])


@pytest.mark.parametrize(("size", "expected"), [(0.1, 1), (0.6, 2), (1.1, 2), (2.0, 3)])
def test_strangers_go_by_their_size(movement, size, expected):
    assert level(movement.of("flux capacitor", (0.05, size, 0.1))) == expected


def test_strangers_go_by_the_most_alike_label_first():
    class Alike:
        space, dimension = "test/2", 2

        def encode_labels(self, labels):
            return np.array(
                [[0.0, 1.0] if label in ("chalice", "cup") else [1.0, 0.0] for label in labels], np.float32
            )

    moves = Movement(load_tables(), Alike())
    assert moves.of("chalice", (2.0, 2.0, 2.0)) == 1.0


def test_questions_come_as_json_and_broken_ones_are_neutral(movement):
    question = dynamic_attribute_request("speaker", (0.2, 0.2, 0.3), ["tv"])[-1].content
    assert movement.answer(question) == 0.25
    assert movement.answer("bathtub") == 0.0
    assert movement.answer("{}") == movement.answer("") == movement.answer("[" * 9999) == NEUTRAL
    for broken in (
        {"label": 3},
        {"label": "xyzzy", "size_m": [None, "a"]},
        {"label": None, "around": 4},
        [1],
    ):
        assert movement.answer(json.dumps(broken)) == NEUTRAL


PLURALS = {
    "shelves": "shelf", "boxes": "box", "glass": "glass", "mugs": "mug", "candies": "candy", "shoes": "shoe",
    "couches": "couch", "clothes": "clothes", "knives": "knife", "cactus": "cactus",
}  # fmt: skip


def test_plurals():
    assert {many: singular(many) for many in PLURALS} == PLURALS


def test_forms_of_a_verb_share_a_stem():
    families = ("wash washes washed washing", "sit sits sitting sat", "bake baking baked", "dry dries drying")
    for forms in map(str.split, families):
        assert len({stem(form) for form in forms}) == 1, forms
    assert stem("reading") != stem("riding")
