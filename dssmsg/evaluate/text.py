"""How well the text encoder answers needs with things: the right label first among all labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
import yaml

from dssmsg.errors import PluginError
from dssmsg.frame import Float32Array
from dssmsg.interfaces.encoder import Encoder
from dssmsg.interfaces.llm import Llm, Message
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.scene import load_scene

SCENES = ("rs_int", "ihlen_1_int")
SETS = ("requests", "situations")
SENTENCES = "data/evaluation/implicit.yaml"


@dataclass(frozen=True, slots=True)
class Answer:
    """One sentence: the labels that would be right, the best-ranked label, and the rank (0 = first) of the
    first right one."""

    text: str
    right: tuple[str, ...]
    said: str
    rank: int


def scene_labels() -> tuple[str, ...]:
    """The labels of everything in the packaged scenes, sorted: what there is to choose from."""
    table = load_categories()
    return tuple(
        sorted({table[piece.category].label for name in SCENES for piece in load_scene(name).pieces()})
    )


def answer_sentences(
    encoder: Encoder, which: str, labels: Sequence[str] | None = None, llm: Llm | None = None
) -> list[Answer]:
    """Rank `labels` (default: those of the packaged scenes) for the sentences of the set `which`.

    With `llm` a sentence is first turned into a target graph, whose core label is looked for, as a mission
    does; where it has no answer the sentence itself is.
    """
    names = list(scene_labels() if labels is None else labels)
    vectors = encoder.encode_labels(names)
    rows = yaml.safe_load(resources.files("dssmsg").joinpath(SENTENCES).read_text("utf-8"))[which]
    answers = []
    for row in rows:
        cosines = vectors @ _wanted(encoder, row["text"], llm)
        order = [names[int(i)] for i in np.argsort(-cosines, kind="stable")]
        right = tuple(name for name in row["right"] if name in names)
        rank = min((order.index(name) for name in right), default=len(order))
        answers.append(Answer(row["text"], right, order[0], rank))
    return answers


def _wanted(encoder: Encoder, sentence: str, llm: Llm | None) -> Float32Array:
    """The vector (D,) that stands for what a sentence asks for."""
    if llm is not None:
        try:
            answer = llm.complete("target_graph", [Message("user", sentence)], {"type": "object"}).value
            core = answer["nodes"][answer["core"]]["label"]
            named: Float32Array = encoder.encode_labels([core])[0]
            return named
        except PluginError:
            pass  # it has no answer to this one
    said: Float32Array = encoder.encode_text([sentence])[0]
    return said


def text_rows(answers: Sequence[Answer], which: str, encoder: str) -> list[dict[str, Any]]:
    """Rows `R@1`, `R@3` of one set, as every evaluation gives them."""
    ranks = np.array([answer.rank for answer in answers])

    def row(metric: str, hits: np.ndarray[Any, Any]) -> dict[str, Any]:
        mean = float(hits.mean())
        return {"table": "text", "scene": which, "method": encoder, "perception": None,
                "metric": metric, "mean": mean, "std": float(np.sqrt(mean * (1 - mean) / len(hits))),
                "n": len(hits)}  # fmt: skip

    return [row("R@1", ranks < 1), row("R@3", ranks < 3)]
