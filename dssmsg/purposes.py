"""Which thing answers a need: sentences compared with names of things and with what they are for.

A text encoder alone often does not know what one wants a thing for; a plain phrase a label does. This finds a
thing where no language model and no lexicon has an answer.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from importlib import resources

import numpy as np

from dssmsg.config_yaml import parse_yaml
from dssmsg.frame import Float32Array
from dssmsg.interfaces.encoder import Encoder

TABLE = "data/purposes.yaml"


@functools.cache
def load_purposes() -> Mapping[str, str]:
    """Label -> what such a thing is for, from the packaged table."""
    text = resources.files("dssmsg").joinpath(TABLE).read_text("utf-8")
    table: Mapping[str, str] = parse_yaml(text, file=TABLE)
    return table


class NeedRanker:
    """Scores labels against sentences; each purpose is encoded once."""

    def __init__(self, encoder: Encoder) -> None:
        self._encoder = encoder
        self._purposes: dict[str, Float32Array] = {}

    def scores(self, sentence: str, labels: Sequence[str]) -> Float32Array:
        """(N,) how well each label answers a sentence: the larger of its cosines with name and purpose.

        A label without an entry in the table is compared by its name alone.
        """
        if not labels:
            return np.zeros(0, np.float32)
        wanted = self._encoder.encode_text([sentence])[0]
        scores = np.array(self._encoder.encode_labels(labels) @ wanted, dtype=np.float32)
        for place, label in enumerate(labels):
            purpose = self._purpose(label)
            if purpose is not None:
                scores[place] = max(scores[place], float(purpose @ wanted))
        return scores

    def _purpose(self, label: str) -> Float32Array | None:
        """The vector (D,) of what a label is for, or None where the table does not say."""
        text = load_purposes().get(label)
        if text is None:
            return None
        if label not in self._purposes:
            self._purposes[label] = self._encoder.encode_text([text])[0]
        return self._purposes[label]
