"""Tiny CLIP towers: the space has an axis for each of red, green and blue; and a tokenizer like CLIP's."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from onnx_graphs import COLOURS, FLOAT, HALF, LONG, Graph

WORDS = ("red", "green", "blue", "a", "photo", "of", "chair")


def tokenizer(path: Path, words=WORDS) -> Path:
    """A byte-level BPE like CLIP's; the words are single tokens, the end token has the highest number."""
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers

    letters = sorted(pre_tokenizers.ByteLevel.alphabet())
    vocabulary = letters + [letter + "</w>" for letter in letters]
    merges: list[tuple[str, str]] = []
    for word in words:
        pieces = [*word[:-1], word[-1] + "</w>"]
        while len(pieces) > 1:
            pairs = list(pairwise(pieces))
            known = [pair for pair in merges if pair in pairs]
            if not known:
                merges.append(pairs[0])
                vocabulary.append("".join(pairs[0]))
            place = pairs.index((known or pairs)[0])
            pieces[place : place + 2] = ["".join(pieces[place : place + 2])]
    vocabulary += ["<|startoftext|>", "<|endoftext|>"]
    numbers = {token: number for number, token in enumerate(vocabulary)}
    made = Tokenizer(
        models.BPE(numbers, merges, end_of_word_suffix="</w>", unk_token="<|endoftext|>", fuse_unk=False)
    )
    made.normalizer = normalizers.Sequence([normalizers.NFC(), normalizers.Lowercase()])
    made.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(
                Regex(r"[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"), behavior="removed", invert=True
            ),
            pre_tokenizers.ByteLevel(add_prefix_space=False),
        ]
    )
    made.save(str(path))
    return path


def token_number(path: Path, token: str) -> int:
    from tokenizers import Tokenizer

    return Tokenizer.from_file(str(path)).token_to_id(token)


def _text_side(graph: Graph, ids: str, tokens: Path, dimension: int) -> str:
    """(B, D): an axis a colour word, a last one for everything else but start, end and what follows it."""
    table = np.zeros((token_number(tokens, "<|endoftext|>") + 1, dimension), np.float32)
    table[:, dimension - 1] = 0.1
    table[-2:] = 0.0
    for axis, word in enumerate(COLOURS):
        number = token_number(tokens, f"{word}</w>")
        table[number] = 0.0
        table[number, axis] = 5.0
    return graph.add(
        "ReduceSum", graph.add("Gather", table, ids, axis=0), np.array([1], np.int64), keepdims=0
    )


def _image_side(graph: Graph, pixels: str, dimension: int) -> str:
    """(B, D): how far each channel lies above CLIP's mean colour; a rim of that colour adds nothing."""
    above = graph.add("Relu", graph.add("ReduceMean", pixels, axes=[2, 3], keepdims=0))
    spread = np.zeros((3, dimension), np.float32)
    spread[:, :3] = np.eye(3)
    some = graph.add("Add", graph.add("MatMul", above, spread), np.float32([0.0] * (dimension - 1) + [0.01]))
    return graph.add("Mul", some, np.float32([7.0]))


def clip_text(
    path: Path, tokens: Path, *, dimension=8, length="sequence", attention=False, batch="batch"
) -> Path:
    graph = Graph()
    ids = graph.input("input_ids", (batch, length), LONG)
    if attention:
        graph.input("attention_mask", (batch, length), LONG)
    graph.output(_text_side(graph, ids, tokens, dimension), "text_embeds", (batch, dimension))
    return graph.save(path)


def clip_vision(
    path: Path, *, dimension=8, batch="batch", half=False, side=224, output="image_embeds"
) -> Path:
    graph = Graph()
    kind = HALF if half else FLOAT
    pixels = graph.input("pixel_values", (batch, 3, side, side), kind)
    graph.output(_image_side(graph, pixels, dimension), output, (batch, dimension), kind)
    return graph.save(path)


def clip_whole(path: Path, tokens: Path, *, dimension=8) -> Path:
    """Both towers in one file, with the logits that the combined export gives too."""
    graph = Graph()
    ids = graph.input("input_ids", ("text_batch", "sequence"), LONG)
    pixels = graph.input("pixel_values", ("image_batch", 3, 224, 224))
    graph.input("attention_mask", ("text_batch", "sequence"), LONG)
    text = _text_side(graph, ids, tokens, dimension)
    image = _image_side(graph, pixels, dimension)
    logits = graph.add("MatMul", image, graph.add("Transpose", text, perm=[1, 0]))
    graph.output(logits, "logits_per_image", ("image_batch", "text_batch"))
    graph.output(text, "text_embeds", ("text_batch", dimension))
    graph.output(image, "image_embeds", ("image_batch", dimension))
    return graph.save(path)
