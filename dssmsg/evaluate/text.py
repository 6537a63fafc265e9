"""How well a sentence that names a need is answered with a thing: the right label first among all labels.

Three sets of sentences, and three methods: the text encoder alone, after the language model's target graph,
and with the table of purposes (`dssmsg.purposes`). Only the set `fresh` was written after that table.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from dssmsg.config_yaml import parse_yaml
from dssmsg.errors import PluginError
from dssmsg.frame import Float32Array
from dssmsg.interfaces.encoder import Encoder
from dssmsg.interfaces.llm import Llm, Message
from dssmsg.purposes import NeedRanker
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.scene import load_scene

SCENES = ("rs_int", "ihlen_1_int")
SETS = ("requests", "situations", "fresh")
SENTENCES = "data/evaluation/implicit.yaml"


Scores = Callable[[str, Sequence[str]], Float32Array]
"""(sentence, N labels) -> (N,) how well each label answers the sentence."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One sentence: the labels that would be right, the best-ranked label, and the rank (0 = first) of the
    first right one."""

    text: str
    right: tuple[str, ...]
    said: str
    rank: int


@functools.cache
def scene_labels() -> tuple[str, ...]:
    """The labels of everything in the packaged scenes, sorted: what there is to choose from."""
    table = load_categories()
    return tuple(
        sorted({table[piece.category].label for name in SCENES for piece in load_scene(name).pieces()})
    )


def answer_sentences(scores: Scores, which: str, labels: Sequence[str] | None = None) -> list[Answer]:
    """Rank `labels` (default: those of the packaged scenes) for the sentences of the set `which`.

    `scores` gives (N,) how well each of N labels answers a sentence; equal ones stay in the order of labels.
    """
    names = list(scene_labels() if labels is None else labels)
    file = resources.files("dssmsg").joinpath(SENTENCES)
    answers = []
    for row in parse_yaml(file.read_text("utf-8"), file=SENTENCES)[which]:
        order = [names[int(i)] for i in np.argsort(-scores(row["text"], names), kind="stable")]
        right = tuple(name for name in row["right"] if name in names)
        rank = min((order.index(name) for name in right), default=len(order))
        answers.append(Answer(row["text"], right, order[0], rank))
    return answers


def methods(encoder: Encoder, encoder_name: str, llm: Llm, llm_name: str) -> dict[str, Scores]:
    """The compared methods by name: the encoder alone, after the language model, with purposes."""
    return {
        encoder_name: lambda sentence, names: _cosines(encoder, sentence, names),
        f"{llm_name} + {encoder_name}": lambda sentence, names: _after_llm(encoder, llm, sentence, names),
        f"{encoder_name} + purposes": NeedRanker(encoder).scores,
    }


def _cosines(encoder: Encoder, sentence: str, names: Sequence[str]) -> Float32Array:
    """(N,) cosines of the labels with the sentence as it stands."""
    cosines: Float32Array = encoder.encode_labels(names) @ encoder.encode_text([sentence])[0]
    return cosines


def _after_llm(encoder: Encoder, llm: Llm, sentence: str, names: Sequence[str]) -> Float32Array:
    """(N,) cosines with the core label of the sentence's target graph, as a mission asks for it; with the
    sentence itself where the model has no answer."""
    try:
        answer = llm.complete("target_graph", [Message("user", sentence)], {"type": "object"}).value
        core = answer["nodes"][answer["core"]]["label"]
    except PluginError:
        return _cosines(encoder, sentence, names)
    cosines: Float32Array = encoder.encode_labels(names) @ encoder.encode_labels([core])[0]
    return cosines


def text_rows(answers: Sequence[Answer], which: str, method: str) -> list[dict[str, Any]]:
    """Rows `R@1`, `R@3` of one set, as every evaluation gives them."""
    ranks = np.array([answer.rank for answer in answers])

    def row(metric: str, hits: np.ndarray[Any, Any]) -> dict[str, Any]:
        mean = float(hits.mean())
        return {"table": "text", "scene": which, "method": method, "perception": None,
                "metric": metric, "mean": mean, "std": float(np.sqrt(mean * (1 - mean) / len(hits))),
                "n": len(hits)}  # fmt: skip

    return [row("R@1", ranks < 1), row("R@3", ranks < 3)]
