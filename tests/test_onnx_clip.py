"""CLIP's towers as encoder and as tagger's words, on tiny graphs whose space has an axis a colour."""

from __future__ import annotations

import gzip

import numpy as np
import onnx_clip_graphs as clips
import onnx_graphs as graphs
import pytest
from box_scene import context
from dssmsg_plugins.encoder import clip

from dssmsg.checks import check_vectors
from dssmsg.errors import ConfigError, InputError
from dssmsg.interfaces import Encoder
from dssmsg.onnx.clip import ClipTokenizer


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clip")
    tokens = clips.tokenizer(folder / "tokenizer.json")
    clips.clip_text(folder / "text.onnx", tokens)
    clips.clip_text(folder / "text_77.onnx", tokens, length=77, batch=1)
    clips.clip_text(folder / "text_attention.onnx", tokens, attention=True)
    clips.clip_text(folder / "text_16.onnx", tokens, dimension=16)
    clips.clip_vision(folder / "vision.onnx")
    clips.clip_vision(folder / "vision_one.onnx", batch=1)
    clips.clip_vision(folder / "vision_three.onnx", batch=3)
    clips.clip_vision(folder / "vision_half.onnx", half=True)
    clips.clip_vision(folder / "vision_open.onnx", side="side")
    clips.clip_vision(folder / "vision_768.onnx", dimension=768, output="pooler_output")
    clips.clip_whole(folder / "model.onnx", tokens)
    return folder


def encoder(files, text="text.onnx", vision="vision.onnx", **options):
    return clip.ClipEncoder(clip.Config(text=text, vision=vision, **options), files)


def crop(colour, size=(30, 50)):
    return np.full((*size, 3), graphs.COLOURS[colour], np.uint8)


PAIRS = [
    ("text.onnx", "vision.onnx"),
    ("text_77.onnx", "vision_one.onnx"),
    ("text_attention.onnx", "vision_three.onnx"),
    ("text.onnx", "vision_half.onnx"),
    ("text.onnx", "vision_open.onnx"),
    ("model.onnx", "model.onnx"),
]


@pytest.mark.parametrize(("text", "vision"), PAIRS)
def test_words_and_pictures_meet(files, text, vision):
    made = encoder(files, text, vision)
    names = ["red", "green", "blue"]
    labels = check_vectors(made.encode_labels(names), 3, 8)
    crops = check_vectors(made.encode_crops([crop(name) for name in names]), 3, 8)
    likeness = crops @ labels.T
    assert likeness.argmax(axis=1).tolist() == [0, 1, 2]
    assert np.diag(likeness).min() > likeness[~np.eye(3, dtype=bool)].max() + 0.5


def test_colours_are_normalised_as_clip_was_trained(files):
    """The tiny tower keeps what lies above CLIP's mean colour, so the answer can be worked out."""
    colour = np.array([200, 150, 110], np.uint8)
    (vector,) = encoder(files).encode_crops([np.tile(colour, (20, 20, 1))])
    expected = np.full(8, 0.0)
    mean, std = (0.48145466, 0.4578275, 0.40821073), (0.26862954, 0.26130258, 0.27577711)
    expected[:3] = np.maximum((colour / 255 - mean) / std, 0)
    expected[7] = 0.01
    np.testing.assert_allclose(vector, expected / np.linalg.norm(expected), atol=1e-3)


def test_the_whole_crop_counts_not_its_middle(files):
    """A sofa is longer than high: cutting a square from its middle would lose its ends."""
    long = np.concatenate([crop("red", (20, 50)), crop("blue", (20, 100)), crop("red", (20, 50))], axis=1)
    (vector,) = encoder(files).encode_crops([long])
    assert vector[0] > 0.1
    assert vector[2] > 0.1


def test_a_vector_does_not_depend_on_its_company(files):
    made = encoder(files)
    alone = made.encode_labels(["red"])[0]
    assert np.array_equal(made.encode_labels(["a very long chair", "red"])[1], alone)
    assert np.array_equal(encoder(files).encode_text(["blue", "a photo of a red"])[1], alone)
    many = made.encode_crops([crop("red")] * 20 + [crop("blue")])
    np.testing.assert_allclose(many[:20], np.tile(many[0], (20, 1)), atol=1e-6)
    assert len(many) == 21


def test_fixed_and_open_lengths_agree(files):
    for text in ("chair", "a photo of a red chair", "chair " * 300, ""):
        np.testing.assert_allclose(
            encoder(files, "text_77.onnx").encode_text([text + " red"])[0],
            encoder(files, "text.onnx").encode_text([text + " red"])[0],
            atol=1e-6,
        )


def test_labels_go_through_the_template_and_are_cached(files, monkeypatch):
    made = encoder(files, template="a {}")
    vector = made.encode_labels(["Red_Chair"])[0]
    assert np.array_equal(vector, made.encode_text(["a red chair"])[0])
    monkeypatch.setattr(made, "_text", None)
    assert np.array_equal(made.encode_labels(["red chair", "RED  chair"]), np.stack([vector, vector]))
    small = encoder(files, cache=2)
    assert small.encode_labels(["red", "green", "blue"]).shape == (3, 8)
    assert len(small._labels) == 2


def test_nothing_in_nothing_out(files):
    made = encoder(files)
    for vectors in (made.encode_labels([]), made.encode_text([]), made.encode_crops([])):
        assert vectors.shape == (0, 8)


def test_the_space_is_named_after_the_files(files, tmp_path):
    made = encoder(files)
    assert made.space.startswith("clip/8/")
    assert made.dimension == 8
    assert encoder(files, vision=None).space == made.space
    assert encoder(files, "text_attention.onnx").space != made.space
    clips.tokenizer(tmp_path / "tokenizer.json", ("red", "green", "blue", "chair"))
    clips.clip_text(tmp_path / "text.onnx", tmp_path / "tokenizer.json")
    assert encoder(tmp_path, vision=None).space != made.space


def test_without_an_image_tower_it_cannot_see(files):
    made = encoder(files, vision=None)
    assert made.encode_crops([crop("red")]) is None
    assert made.encode_labels(["red"]).shape == (1, 8)


def test_tokens_are_clips(files):
    tokens = ClipTokenizer(files / "tokenizer.json", "")
    start, end = (
        clips.token_number(files / "tokenizer.json", f"<|{one}oftext|>") for one in ("start", "end")
    )
    red = clips.token_number(files / "tokenizer.json", "red</w>")
    assert tokens.ids("RED") == [start, red, end]
    assert len(tokens.ids("red " * 100)) == 77
    assert tokens.ids("red " * 100)[-1] == end
    assert tokens.ids("") == [start, end]


def test_the_vocabulary_of_openais_code_serves_too(tmp_path):
    merges = ["r e", "re d</w>", "' s</w>", "s o"]
    text = "#version: 0.2\n" + "\n".join(merges) + "\n"
    (tmp_path / "bpe.txt.gz").write_bytes(gzip.compress(text.encode()))
    (tmp_path / "bpe.txt").write_text(text)
    for name in ("bpe.txt.gz", "bpe.txt"):
        tokens = ClipTokenizer(tmp_path / name, "")
        start, end = 512 + len(merges), 513 + len(merges)
        # Letters are numbered from "!" on, ends of words 256 above; merges follow.
        assert tokens.ids("Red") == [start, 513, end]
        assert tokens.ids("red's\n so!") == [start, 513, 514, 82, 334, 256, end]
        assert tokens.ids("\u00e9") == [start, 127, 358, end]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"nonsense", "cannot be read as a vocabulary"),
        (gzip.compress(b"#version\nre d</w>\n"), "do not build on one another"),
        (gzip.compress(b"#version\na b c\n"), "two pieces of words a line"),
        (gzip.compress(b"#version\n"), "two pieces of words a line"),
        (gzip.compress(b"x" * 17_000_000), "expected at most 16000000 bytes"),
    ],
    ids=["no gzip", "gaps", "three pieces", "empty", "bomb"],
)
def test_bad_vocabularies(tmp_path, content, message):
    (tmp_path / "bpe.txt.gz").write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        ClipTokenizer(tmp_path / "bpe.txt.gz", "")
    assert error.value.key == ".tokenizer"


def test_the_tokenizer_lies_beside_the_tower_or_above_it(files, tmp_path):
    folder = tmp_path / "onnx"
    folder.mkdir()
    tokens = clips.tokenizer(tmp_path / "tokenizer.json")
    clips.clip_text(folder / "text_model.onnx", tokens)
    config = clip.Config(text="onnx/text_model.onnx")
    assert clip.ClipEncoder(config, tmp_path).dimension == 8
    tokens.unlink()
    with pytest.raises(ConfigError, match=r"no tokenizer\.json lies beside text_model\.onnx") as error:
        clip.ClipEncoder(config, tmp_path)
    assert error.value.key == ".tokenizer"


REFUSED = [
    (
        {"vision": "vision_768.onnx"},
        ".vision",
        r"768 numbers, those of the text tower text\.onnx 8; .*projections",
    ),
    ({"text": "text_16.onnx"}, ".vision", r"have 8 numbers, those of the text tower text_16\.onnx 16"),
    (
        {"text": "vision.onnx"},
        ".text",
        r"that is CLIP image tower, which goes into encoder: {use: clip, vision: FILE",
    ),
    ({"vision": "text.onnx"}, ".vision", r"that is CLIP text tower"),
    ({"vision": "gone.onnx"}, ".vision", "no such file"),
    ({"text": "tokenizer.json"}, ".text", "expected an ONNX model that onnxruntime"),
    ({"tokenizer": "text.onnx"}, ".tokenizer", r"expected the tokenizer\.json of a CLIP model"),
    ({"tokenizer": "other.json"}, ".tokenizer", "is no tokenizer of a CLIP model"),
    ({"tokenizer": "large.json"}, ".text", r"cannot encode a text with large\.json: text\.onnx failed"),
    ({"text_sha256": "0" * 64}, ".text", r"expected the file with SHA-256 0{12}\.\.\., this one has"),
    ({"tokenizer_sha256": "0" * 64}, ".tokenizer_sha256", "expected the file with SHA-256 0{12}"),
]


@pytest.mark.parametrize(("options", "key", "message"), REFUSED, ids=lambda value: str(value)[:40])
def test_what_does_not_fit_is_refused(files, options, key, message):
    from tokenizers import Tokenizer, models

    Tokenizer(models.BPE({"a": 0}, [])).save(str(files / "other.json"))
    clips.tokenizer(files / "large.json", (*clips.WORDS, "onemoreword"))
    with pytest.raises((ConfigError, InputError), match=message) as error:
        encoder(files, **options)
    assert error.value.key == key
    assert error.value.file is not None


def test_pinned_files_pass(files):
    made = encoder(files)
    assert encoder(files, text_sha256=made._text.sha256.upper(), vision_sha256=made._vision.sha256).space


def test_factory_and_problems(files):
    config = clip.Config(text=str(files / "text.onnx"), vision=str(files / "vision.onnx"))
    assert isinstance(clip.make(config, context()), Encoder)
    assert config.problems(files, None) == []
    (text,) = clip.Config(text="text.onnx", vision="vision_768.onnx").problems(files, None)
    assert text.startswith(f"vision: {files / 'vision_768.onnx'}: its vectors have 768 numbers")
    assert all(field.description for field in clip.Config.model_fields.values())
