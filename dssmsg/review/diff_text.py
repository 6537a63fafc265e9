"""A difference of two runs as lines for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from dssmsg.review.diff import Difference, Query, Setting, Side
from dssmsg.review.diff_objects import ObjectBrief
from dssmsg.review.divergence import Divergence, Term

MAX_ROWS = 15
"""Rows of a list that are told; the rest is counted."""
_WIDTH = 13


def difference_text(difference: Difference) -> str:
    """The whole difference, the first divergence foremost."""
    return "\n".join(_lines(difference))


def _lines(d: Difference) -> Iterator[str]:
    yield _row("A", _side(d.a))
    yield _row("B", _side(d.b))
    yield from _block("settings", [_setting(one) for one in d.settings], "the same")
    yield from _images(d)
    yield from _divergence(d)
    yield from _objects(d)
    differing = [f"{kind} {a} -> {b}" for kind, (a, b) in d.changes.items() if a != b]
    yield _row(
        "changes", f"{d.a.changes} -> {d.b.changes}" + (f": {', '.join(differing)}" if differing else "")
    )
    yield from _block(
        "scores",
        [
            f"{one.rule}, {one.score}: {one.count_a} -> {one.count_b} times,"
            f" mean {_number(one.mean_a)} -> {_number(one.mean_b)}"
            + (
                f", least margin {_number(one.margin_a)} -> {_number(one.margin_b)}"
                if (one.margin_a, one.margin_b) != (None, None)
                else ""
            )
            for one in d.rules
        ],
        "the same",
    )
    if d.queries:
        yield from _block("matches", [line for one in d.queries for line in _query(one)])
    if d.episodes:
        yield from _block(
            "episodes",
            [
                f"{one.episode} “{one.goal}”: {one.a}"
                + ("" if one.a == one.b else f" -> {one.b}")
                + "".join(f", {name} {_number(a)} -> {_number(b)}" for name, (a, b) in one.values.items())
                for one in d.episodes
            ],
        )
    if d.errors != (0, 0):
        yield _row("errors", f"{d.errors[0]} -> {d.errors[1]}")
    yield _row(
        "ms a frame",
        ", ".join(f"{stage} {_number(a)} -> {_number(b)}" for stage, (a, b) in d.milliseconds.items())
        or "not timed",
    )


def _side(side: Side) -> str:
    relation = {"": "", "parent": ", parent of the other", "replay": ", replay of the other"}[side.relation]
    return f"{side.recording}: {side.scene}, seed {side.seed}, {side.frames} frames{relation}"


def _setting(setting: Setting) -> str:
    return f"{setting.key}: {_value(setting.a)} -> {_value(setting.b)}"


def _images(d: Difference) -> Iterator[str]:
    """A replay of images with losses sees others than the run did."""
    for name, side in (("A", d.a), ("B", d.b)):
        if side.relation == "parent" and side.images != "lossless":
            yield _row(
                "images",
                f"{name}'s are {side.images.upper()}: its replay sees colours a little otherwise, so they"
                " and scores made of them differ",
            )


def _divergence(d: Difference) -> Iterator[str]:
    if d.divergence is None:
        equal = "decision" if d.traces else "change"
        yield _row("parted", f"nowhere: every frame, detection, {equal}, match and episode is the same")
    else:
        yield from _parting("parted", d.divergence)
        if d.because:
            yield from _block("", [f"because {_setting(one)}" for one in d.because])
        else:
            yield _row("", "no setting of this layer differs: other data, other code or chance")
    for place, trace in enumerate(d.traces):
        yield from _parting("first trace" if place == 0 else "trace", trace)


def _parting(name: str, one: Divergence) -> Iterator[str]:
    plugin = "" if one.plugin in ("", one.layer) else f" ({one.plugin})"
    yield _row(name, f"frame {one.frame}, {one.layer}{plugin}: {one.what}")
    if one.a or one.b:
        yield _row("", f"A  {one.a}")
        yield _row("", f"B  {one.b}")
    terms = [_term(term) for term in one.scores if (term.a, term.threshold_a) != (term.b, term.threshold_b)]
    if terms:
        yield _row("", "scores " + "; ".join(terms))


def _term(term: Term) -> str:
    limits = (
        ""
        if term.threshold_a is None and term.threshold_b is None
        else f" (threshold {_number(term.threshold_a)} -> {_number(term.threshold_b)})"
    )
    return f"{term.name} {_number(term.a)} -> {_number(term.b)}{limits}"


def _objects(d: Difference) -> Iterator[str]:
    objects = d.objects
    yield _row(
        "objects",
        f"{objects.same} the same, {len(objects.differing)} differ,"
        f" {len(objects.only_a)} only in A, {len(objects.only_b)} only in B",
    )
    rows = [
        f"{pair.a.id} / {pair.b.id}: "
        + ", ".join(f"{name} {getattr(pair.a, name)} -> {getattr(pair.b, name)}" for name in pair.differs)
        for pair in objects.differing
    ]
    rows += [f"only in A: {_brief(one)}" for one in objects.only_a]
    rows += [f"only in B: {_brief(one)}" for one in objects.only_b]
    yield from _block("", rows)


def _brief(one: ObjectBrief) -> str:
    place = ", ".join(f"{value:.2f}" for value in one.center)
    return f"{one.id} {one.label} ({one.status}, {one.state}) at ({place}), seen {one.observations} times"


def _query(one: Query) -> Iterator[str]:
    if one.only_in:
        top = one.top_a or one.top_b
        yield f"“{one.query}”: asked in {one.only_in.upper()} alone"
        yield f"  {one.only_in.upper()}  {_candidates(top)}"
        return
    same = one.top_a == one.top_b
    target = "" if one.target_same else "; another target graph"
    yield f"“{one.query}”: " + ("the same ranks" if same else "other ranks or scores") + target
    if not same:
        yield f"  A  {_candidates(one.top_a)}"
        yield f"  B  {_candidates(one.top_b)}"
        if one.top_a and one.top_b and one.top_a[0][0] != one.top_b[0][0]:
            yield f"  A's best has rank {one.best_a_in_b} in B, B's best rank {one.best_b_in_a} in A"


def _candidates(top: Sequence[tuple[str, float | None]]) -> str:
    return ", ".join(f"{name} {_number(score)}" for name, score in top) or "no candidate"


def _block(name: str, rows: Iterable[str], nothing: str = "") -> Iterator[str]:
    told = list(rows)
    if not told and nothing:
        yield _row(name, nothing)
    for place, row in enumerate(told[:MAX_ROWS]):
        yield _row(name if place == 0 else "", row)
    if len(told) > MAX_ROWS:
        yield _row("", f"... and {len(told) - MAX_ROWS} more")


def _row(name: str, text: str) -> str:
    return f"{name:<{_WIDTH}}{text}".rstrip()


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


def _value(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 80 else text[:77] + "..."
