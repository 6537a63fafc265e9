"""Why one viewpoint won a query, and what the ones that came behind it lacked: term by term, with margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dssmsg.graph.ids import id_order

Json = Mapping[str, Any]

_WEIGHTS = {
    "s_node": None,
    "s_top": None,
    "s_core": "core_weight",
    "s_relation": "relation_weight",
    "s_attribute": "attribute_weight",
    "s_view": "view_weight",
}
"""Terms of the score of `grounding/dssm`; the option that weighs each, None for the paper's (weight 1)."""
_MEANING = {
    "s_node": "how well the named things fit what is seen from there",
    "s_top": "how alike the relations hang together",
    "s_core": "how well what is looked for itself fits, of all in the map",
    "s_relation": "whether the named relations hold",
    "s_attribute": "whether it looks as described",
    "s_view": "how large it is in the image",
}
_EQUAL = 1e-9
_TIES = {
    "similarity": ("the larger summed similarity", "", 6, 1),
    "core_distance": ("the nearer thing", " metres", 15, -1),
}
"""What settles equal scores, in this order: in words, its unit, how many digits count, whether more (1) or
less (-1) wins."""
BY_ID, UNKNOWN = "viewpoint id", "unknown"


@dataclass(frozen=True, slots=True)
class TermGap:
    """One term of two candidates. `gap` is what it adds to the difference of the scores."""

    name: str
    weight: float
    winner: float
    other: float

    @property
    def gap(self) -> float:
        """Weighted difference, positive where it speaks for the winner."""
        return self.weight * (self.winner - self.other)


@dataclass(frozen=True, slots=True)
class Comparison:
    """The winner against another candidate: the terms, those that decided most first."""

    kind: str
    best: Json
    other: Json
    margin: float | None
    terms: tuple[TermGap, ...]

    @property
    def decisive(self) -> TermGap | None:
        """The term that made most of the difference; None where no score differs."""
        apart = [term for term in self.terms if abs(term.gap) > _EQUAL]
        return max(apart, key=lambda term: term.gap) if apart and self.margin else None

    @property
    def tied(self) -> bool:
        """Whether both have the same score."""
        return self.margin is not None and abs(self.margin) <= _EQUAL


@dataclass(frozen=True, slots=True)
class QueryExplained:
    """A grounded query, its winner and what it was compared with.

    That is the best of another waypoint (other views of its own are the same place), and the best that took
    another thing for what is looked for.
    """

    query: str
    frame: int
    recorded: bool
    target: Json
    candidates: Sequence[Json]
    comparisons: tuple[Comparison, ...]

    @property
    def winner(self) -> Json | None:
        """The best candidate."""
        return self.candidates[0] if self.candidates else None


def explain_match(match: Json, grounding: Json, *, recorded: bool) -> QueryExplained:
    """Compare the winner of a match with the others; `grounding` are the options that it was ranked with."""
    candidates = match["candidates"]
    core = str(match["target"]["core"])
    weights = _weights(grounding, match["target"])
    comparisons = []
    if len(candidates) > 1:
        first, *others = candidates
        place = _waypoint(first)
        runner_up = next((one for one in others if _waypoint(one) != place), others[0])
        comparisons.append(_compare("runner-up", first, runner_up, weights))
        taken = first["matching"].get(core)
        # Where nothing was taken for the core, there is no other thing to speak of.
        another = next((one for one in others if one["matching"].get(core, taken) != taken), None)
        if another is not None and another is not runner_up:
            comparisons.append(_compare("best with another thing", first, another, weights))
    return QueryExplained(
        match["query"], match["frame"], recorded, match["target"], candidates, tuple(comparisons)
    )


def _waypoint(candidate: Json) -> str:
    """What the viewpoints of one waypoint have in common: viewpoint-3 of viewpoint-3.2."""
    return str(candidate["viewpoint"]).partition(".")[0]


def _weights(grounding: Json, target: Json) -> dict[str, float]:
    if grounding.get("use") != "dssm":
        return {}
    weights = {
        name: 1.0 if option is None else float(grounding.get(option, 0.0))
        for name, option in _WEIGHTS.items()
    }
    if target.get("kind") == "implicit":
        weights["s_relation"] *= float(grounding.get("guessed", 1.0))
    return weights


def _compare(kind: str, winner: Json, other: Json, weights: Mapping[str, float]) -> Comparison:
    own, theirs = winner["scores"], other["scores"]
    terms = [
        TermGap(name, weights.get(name, 1.0), own.get(name, 0.0), theirs.get(name, 0.0))
        for name in (weights or {name: 1.0 for name in own if name.startswith("s_")})
        if name in own or name in theirs
    ]
    margin = own["score"] - theirs["score"] if "score" in own and "score" in theirs else None
    return Comparison(kind, winner, other, margin, tuple(sorted(terms, key=lambda term: -abs(term.gap))))


def query_explained_json(path: str, told: QueryExplained) -> dict[str, Any]:
    """What `explain --query --json` prints."""
    return {
        "recording": path,
        "query": told.query,
        "frame": told.frame,
        "recorded": told.recorded,
        "target": dict(told.target),
        "winner": None if told.winner is None else dict(told.winner),
        "candidates": len(told.candidates),
        "comparisons": [
            {
                "kind": one.kind,
                "candidate": dict(one.other),
                "margin": one.margin,
                "decisive": None if one.decisive is None else one.decisive.name,
                "tie": tie_of(one) if one.tied else None,
                "terms": [
                    {
                        "name": term.name,
                        "weight": term.weight,
                        "winner": term.winner,
                        "other": term.other,
                        "gap": term.gap,
                    }
                    for term in one.terms
                ],
            }
            for one in told.comparisons
        ],
        "view": _view(path, told),
    }


def query_explained_text(path: str, told: QueryExplained) -> str:
    """One page for a reader."""
    target = told.target
    nodes = [" ".join((*node["attributes"], node["label"])) for node in target["nodes"]]
    how = "as recorded" if told.recorded else "grounded anew in the recorded map"
    lines = [
        f"{told.query}: {how}, at frame {told.frame}",
        f"  {target['kind']}, looking for {nodes[target['core']]}",
    ]
    lines += [f"  {nodes[e['source']]} {e['relation']} {nodes[e['target']]}" for e in target["edges"]]
    if told.winner is None:
        return "\n".join([*lines, "", "nothing in the map matched: there is no viewpoint to explain"])
    lines += ["", f"{told.winner['viewpoint']} won of {len(told.candidates)}: {_told(told.winner)}"]
    if not told.comparisons:
        lines.append("  there was no other candidate")
    for one in told.comparisons:
        lines += ["", f"{one.kind}: {one.other['viewpoint']}, rank {one.other['rank']}: {_told(one.other)}"]
        lines.append(f"  {_why(one)}")
        if one.tied:
            continue
        lines += [
            f"  {term.name:<12}{term.winner:7.3f} against {term.other:6.3f}, weight {term.weight:g}:"
            f" {term.gap:+.3f}  ({_MEANING.get(term.name, 'a term of its own')})"
            for term in one.terms
        ]
    return "\n".join([*lines, "", f"look at it: {_view(path, told)}"])


def _told(candidate: Json) -> str:
    score = candidate["scores"].get("score")
    return (f"score {score:.3f}; " if score is not None else "") + str(candidate["reason"])


def _why(one: Comparison) -> str:
    if one.margin is None:
        return "these candidates carry no common score"
    if one.tied:
        return f"equal scores; {_tie_told(one)}"
    decisive = one.decisive
    if decisive is None:
        return f"behind by {one.margin:.3f}; none of the recorded terms differs"
    lacked = _MEANING.get(decisive.name, decisive.name)
    return f"behind by {one.margin:.3f}, most of all for {decisive.name} ({decisive.gap:+.3f}): {lacked}"


def tie_of(one: Comparison) -> str:
    """What settled equal scores: a score by its name, the id, or what is not recorded."""
    own, theirs = one.best["scores"], one.other["scores"]
    for name, (_, _, digits, sign) in _TIES.items():
        if name in own and name in theirs:
            ahead = sign * (round(own[name], digits) - round(theirs[name], digits))
            if ahead:
                # A grounding of another order has put them by something that it does not tell.
                return name if ahead > 0 else UNKNOWN
    try:
        ordered = id_order(one.best["viewpoint"]) < id_order(one.other["viewpoint"])
    except ValueError:  # no ids of ours
        return UNKNOWN
    return BY_ID if ordered else UNKNOWN


def _tie_told(one: Comparison) -> str:
    settled = tie_of(one)
    if settled == UNKNOWN:
        return "what decided is not recorded"
    if settled == BY_ID:
        return "nothing else differs either: the smaller viewpoint id decided"
    own, theirs = _apart(one.best["scores"][settled], one.other["scores"][settled])
    words, unit, *_ = _TIES[settled]
    return f"{words} decided: {own} against {theirs}{unit}"


def _apart(a: float, b: float) -> tuple[str, str]:
    """Two numbers with three digits, or so many that they differ."""
    pairs = ((f"{a:.{digits}f}", f"{b:.{digits}f}") for digits in range(3, 16))
    return next((pair for pair in pairs if pair[0] != pair[1]), (str(a), str(b)))


def _view(path: str, told: QueryExplained) -> str:
    focus = "" if told.winner is None else f" --focus {told.winner['viewpoint']}"
    return f"dssmsg view {path} --at frame={max(told.frame, 0)}{focus}"
