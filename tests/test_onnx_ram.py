"""The RAM tagger on tiny graphs: it names the colours in a frame."""

from __future__ import annotations

from types import SimpleNamespace

import onnx_graphs as graphs
import pytest
from box_scene import context
from dssmsg_plugins.tagger import ram

from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Tagger

TAGS = ("red", "green", "blue", "room")


def tagger(tmp_path, **options):
    return ram.RamTagger(ram.Config(model="ram.onnx", **({"tags": TAGS} | options)), tmp_path)


def frame_of(*colours):
    shapes = [(colour, (10 + 50 * i, 20, 50 + 50 * i, 60)) for i, colour in enumerate(colours)]
    return SimpleNamespace(rgb=graphs.picture(shapes))


@pytest.mark.parametrize("flags", [True, False])
def test_it_names_what_is_there(tmp_path, flags):
    graphs.ram(tmp_path / "ram.onnx", flags=flags)
    made = tagger(tmp_path)
    assert made.tags(frame_of("blue", "red")) == ["red", "blue"]
    assert made.tags(frame_of()) == []
    assert made.tags(frame_of("green")) == ["green"]


def test_thresholds_of_logits(tmp_path):
    graphs.ram(tmp_path / "ram.onnx", flags=False)
    assert tagger(tmp_path, threshold=0.85).tags(frame_of("blue", "red")) == ["red"]
    (tmp_path / "thresholds.txt").write_text("0.95\n0.5\n0.5\n0.5\n")
    assert tagger(tmp_path, threshold="thresholds.txt").tags(frame_of("blue", "red")) == ["blue"]


def test_some_are_left_out(tmp_path):
    graphs.ram(tmp_path / "ram.onnx")
    frame = frame_of("blue", "red", "green")
    assert tagger(tmp_path, exclude=["green"]).tags(frame) == ["red", "blue"]
    assert tagger(tmp_path, limit=1).tags(frame) == ["red"]


def test_the_tag_list_is_a_file_or_the_models_own_note(tmp_path):
    graphs.ram(tmp_path / "ram.onnx")
    (tmp_path / "ram_tag_list.txt").write_bytes("\ufeffred\r\ngreen\r\nblue\r\nroom\r\n".encode())
    assert tagger(tmp_path, tags="ram_tag_list.txt").tags(frame_of("blue")) == ["blue"]


REFUSED = [
    ({"tags": None}, ".tags", "the file does not name its 4 classes"),
    ({"tags": TAGS[:3]}, ".tags", r"expected 4 names, one for each class of the file, got 3 \(red"),
    ({"tags": "gone.txt"}, ".tags", "no such file"),
    ({"tags": "holes.txt"}, ".tags", "one name a line, no line empty"),
    ({"tags": "ram.onnx"}, ".tags", "UTF-8|one name a line"),
    ({"threshold": "three.txt"}, ".threshold", "expected 4 thresholds, one for each tag of the model, got 3"),
    ({"threshold": "words.txt"}, ".threshold", "a number on each line"),
    ({"threshold": "high.txt"}, ".threshold", r"numbers in 0\.\.1"),
    ({"exclude": ["sofa"]}, ".exclude", "no such tags: sofa"),
    ({"sha256": "1" * 64}, ".model", "expected the file with SHA-256 1{12}"),
]


@pytest.mark.parametrize(("options", "key", "message"), REFUSED, ids=lambda value: str(value)[:40])
def test_what_does_not_fit_is_refused(tmp_path, options, key, message):
    graphs.ram(tmp_path / "ram.onnx")
    texts = {"holes": "red\n\nblue\nroom\n", "three": "0.1\n" * 3, "words": "a\n" * 4, "high": "7\n" * 4}
    for name, text in texts.items():
        (tmp_path / f"{name}.txt").write_text(text)
    with pytest.raises((ConfigError, InputError), match=message) as error:
        tagger(tmp_path, **options)
    assert error.value.key == key
    assert error.value.file is not None


def test_another_model_is_refused(tmp_path):
    graphs.yolo(tmp_path / "ram.onnx")
    with pytest.raises(
        ConfigError, match=r"that is Ultralytics export.*accepted here: RAM or RAM\+\+ tagger"
    ):
        tagger(tmp_path)


def test_factory_and_problems(tmp_path):
    graphs.ram(tmp_path / "ram.onnx")
    config = ram.Config(model=str(tmp_path / "ram.onnx"), tags=TAGS)
    assert isinstance(ram.make(config, context()), Tagger)
    assert config.problems(tmp_path, None) == []
    (text,) = ram.Config(model="ram.onnx").problems(tmp_path, None)
    assert text.startswith(f"tags: {tmp_path / 'ram.onnx'}: the file does not name its 4 classes")
    assert all(field.description for field in ram.Config.model_fields.values())
