"""Whether a thing looks as a sentence says: colours by its points, sizes against its likes.

Beyond the paper. Words for what no camera here measures (wooden, old, quiet) are passed over, neither right
nor wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dssmsg.frame import ByteArray, FloatArray, MaskArray
from dssmsg.graph.colors import hsv_of
from dssmsg.graph.subgraph import Thing

_ENOUGH = 0.4
"""Share of points in a colour from which on a thing is of it: handles, screens and shade never are."""
_GREY, _FAINT = 0.18, 0.3
_DARK, _LIGHT = 0.3, 0.72

Rule = Callable[[FloatArray, FloatArray, FloatArray], MaskArray]


def _hued(low: float, high: float, least: float = _FAINT) -> Rule:
    """Degrees of hue from `low` to `high`, around zero if need be, of some saturation and not black."""

    def rule(hue: FloatArray, saturation: FloatArray, value: FloatArray) -> MaskArray:
        angle = hue * 360.0
        inside = (angle >= low) & (angle < high) if low < high else (angle >= low) | (angle < high)
        return inside & (saturation >= least) & (value > 0.15)

    return rule


COLORS: Mapping[str, Rule] = {
    "red": _hued(340, 18, 0.4),
    "orange": _hued(15, 42, 0.5),
    "yellow": _hued(40, 70),
    "green": _hued(70, 165, 0.2),
    "turquoise": _hued(155, 200),
    "blue": _hued(190, 262, 0.25),
    "purple": _hued(255, 325, 0.2),
    "pink": lambda h, s, v: ((h > 0.8) | (h < 0.03)) & (s > 0.15) & (s < 0.65) & (v > 0.5),
    "brown": lambda h, s, v: (h < 0.13) & (s > 0.22) & (v > 0.1) & (v < 0.72),
    "beige": lambda h, s, v: (h > 0.03) & (h < 0.19) & (s > 0.08) & (s < 0.5) & (v > 0.5),
    "black": lambda _h, s, v: (v < _DARK) & (s < 0.6),
    "white": lambda _h, s, v: (s < _GREY) & (v > 0.66),
    "grey": lambda _h, s, v: (s < _GREY) & (v >= 0.22) & (v < 0.8),
    "dark": lambda _h, _s, v: v < 0.42,
    "light": lambda _h, _s, v: v > 0.6,
    "colourful": lambda _h, s, v: (s > 0.5) & (v > 0.3),
}
_SAME = {
    "gray": "grey", "silver": "grey", "cream": "beige", "violet": "purple", "teal": "turquoise",
    "golden": "yellow", "bright": "light", "pale": "light", "colorful": "colourful", "navy": "dark blue",
}  # fmt: skip

_SIZES: Mapping[str, tuple[str, int]] = {
    **dict.fromkeys(("big", "large", "huge", "spacious"), ("volume", 1)),
    **dict.fromkeys(("small", "little", "tiny", "compact"), ("volume", -1)),
    **dict.fromkeys(("tall", "high"), ("height", 1)),
    **dict.fromkeys(("low", "short"), ("height", -1)),
    **dict.fromkeys(("long", "wide", "broad", "double"), ("width", 1)),
    **dict.fromkeys(("narrow", "slim", "single"), ("width", -1)),
}


def attribute_score(words: Sequence[str], thing: Thing, likes: Sequence[Thing]) -> float | None:
    """How well the words describe a thing, 0..1, averaged; None where none of them can be checked.

    `likes` are the things it could be confused with, itself among them: a size is one of theirs compared.
    """
    scores = [
        score for word in words if (score := _one(" ".join(word.lower().split()), thing, likes)) is not None
    ]
    return sum(scores) / len(scores) if scores else None


def color_share(word: str, colors: ByteArray) -> float | None:
    """Share of colours (N, 3) uint8 that a colour word names; None for another word or no colours."""
    word = _SAME.get(word, word)
    rules = [COLORS.get(part) for part in word.split()]
    if not rules or not len(colors) or any(rule is None for rule in rules):
        return None
    hue, saturation, value = hsv_of(colors).T
    fits = np.ones(len(colors), bool)
    for rule in rules:
        assert rule is not None
        fits &= rule(hue, saturation, value)
    return float(fits.mean())


def _one(word: str, thing: Thing, likes: Sequence[Thing]) -> float | None:
    """One attribute: a word, `not` one, or several with `or` between them."""
    choices = [_one(choice, thing, likes) for choice in word.split(" or ")] if " or " in word else []
    if choices:
        return max((score for score in choices if score is not None), default=None)
    if word.startswith("not "):
        score = _one(word.removeprefix("not "), thing, likes)
        return None if score is None else 1.0 - score
    return _measure(word, thing, likes)


def _measure(word: str, thing: Thing, likes: Sequence[Thing]) -> float | None:
    share = color_share(word, thing.colors)
    if share is not None:
        return min(1.0, share / _ENOUGH)
    if word not in _SIZES:
        return None
    measure, sign = _SIZES[word]
    others = [one for one in likes if one is not thing]
    if not others:
        return None
    own = sign * _measured(thing, measure)
    return sum(own > sign * _measured(one, measure) for one in others) / len(others)


def _measured(thing: Thing, measure: str) -> float:
    extent = thing.box_max - thing.box_min
    if measure == "height":
        return float(extent[2])
    if measure == "width":
        return float(extent[:2].max())
    return float(np.prod(np.maximum(extent, 0.02)))
