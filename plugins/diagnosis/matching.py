"""diagnosis/matching: was the target graph held against the map rightly, and did the best one win?"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, same_thing
from dssmsg.review.episode_map import ObjectHistory
from dssmsg.review.episode_rule import EpisodeRule

WEIGHTS = {
    "s_core": "core_weight",
    "s_relation": "relation_weight",
    "s_attribute": "attribute_weight",
    "s_view": "view_weight",
}
"""Terms of `grounding/dssm`, and the option that weighs each."""


class Config(PluginConfig):
    """Options of the rule `matching`."""

    tolerance: float = Field(1e-6, gt=0, description="Scores that are nearer than this are equal.")
    passed_over: float = Field(
        0.75, ge=0, le=1, description="How sure, where the map has what is asked for and another thing won."
    )


class MatchingRule(EpisodeRule[Config]):
    """Adds the recorded terms up again, checks the order, and looks for a better answer in the map."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """Findings of all checks that do not hold."""
        if case.match is None:
            return ()
        if not case.candidates:
            return [*self._nothing_found(case)]
        return [*self._sums(case), *self._order(case), *self._unseen(case), *self._passed_over(case)]

    def _sums(self, case: EpisodeCase) -> Iterator[Finding]:
        """Does each score follow from its terms and the configured weights?"""
        options = case.recording.config.get("grounding", {})
        if options.get("use") != "dssm" or not all(name in options for name in WEIGHTS.values()):
            return
        target = case.match["target"] if case.match else {}
        for one in case.candidates:
            expected = _score(one["scores"], options, target)
            if expected is None or abs(expected - one["scores"]["score"]) <= self.config.tolerance:
                continue
            value = one["scores"]["score"]
            terms = ", ".join(f"{k} {v:.3f}" for k, v in one["scores"].items() if k.startswith("s_"))
            yield self._finding(
                case,
                0.9,
                f"the score of {one['viewpoint']} does not follow from its terms and the configured weights",
                [f"{one['viewpoint']} ({one['rank']}.): {terms}: that is {expected:.3f}, not {value:.3f}"],
                Decision(f"score of {one['viewpoint']}", value, expected),
            )
            return

    def _order(self, case: EpisodeCase) -> Iterator[Finding]:
        """Does the highest score come first?"""
        scored = [one for one in case.candidates if "score" in one["scores"]]
        if not scored:
            return
        first, best = scored[0], max(scored, key=lambda one: one["scores"]["score"])
        value, against = first["scores"]["score"], best["scores"]["score"]
        if against - value > self.config.tolerance:
            yield self._finding(
                case,
                0.9,
                f"{first['viewpoint']} came first, though {best['viewpoint']} has the higher score",
                [f"{best['viewpoint']} was ranked {best['rank']}: {best['reason']}"],
                Decision(f"score of {first['viewpoint']}", value, against),
            )

    def _unseen(self, case: EpisodeCase) -> Iterator[Finding]:
        """Was what is taken for the target ever seen from the viewpoint that won?"""
        first = case.candidates[0]
        object_id = first["matching"].get(_core(case), "")
        history = case.recording.history
        thing = history.objects.get(object_id)
        views = history.seen_from(object_id, case.last)
        if thing is None or not thing.is_there(case.last) or first["viewpoint"] in views:
            return
        yield self._finding(
            case,
            0.85,
            f"{first['viewpoint']} won with {object_id} ({thing.label()}), which was never seen from there",
            [f"{object_id} was seen from {', '.join(views) or 'no viewpoint'}"],
            None,
            object_id,
        )

    def _passed_over(self, case: EpisodeCase) -> Iterator[Finding]:
        """Does the map hold what the target graph asks for, while something else won?"""
        assert case.match is not None
        first = case.candidates[0]
        won = case.recording.history.last(first["matching"].get(_core(case), ""))
        at = case.match["frame"]
        if won is not None and same_thing(won.label(at), [case.core]):
            return
        better = _there(case, at)
        if not better:
            return
        rival = next(
            (one for one in case.candidates if one["matching"].get(_core(case)) in {b.id for b in better}),
            None,
        )
        label = "nothing" if won is None else f"{won.id} ({won.label(at)})"
        decision = None
        if rival is not None and "score" in rival["scores"]:
            decision = Decision(
                f"score of {first['viewpoint']}", first["scores"]["score"], rival["scores"]["score"]
            )
        yield self._finding(
            case,
            self.config.passed_over,
            f"{label} was taken for the {case.core}, though there is {better[0].id} ({better[0].label(at)})",
            [f"{first['viewpoint']} won: {first['reason']}"],
            decision,
            better[0].id,
        )

    def _nothing_found(self, case: EpisodeCase) -> Iterator[Finding]:
        assert case.match is not None
        there = _there(case, case.match["frame"])
        if there:
            views = case.recording.history.seen_from(there[0].id, case.match["frame"])
            yield self._finding(
                case,
                0.85,
                f"nothing was matched, though the map holds {there[0].id} ({there[0].label()})",
                [f"{there[0].id} was seen from {', '.join(views)}"],
                None,
                there[0].id,
            )

    @staticmethod
    def _finding(
        case: EpisodeCase,
        confidence: float,
        summary: str,
        events: Sequence[str],
        decision: Decision | None,
        focus: str = "",
    ) -> Finding:
        assert case.match is not None
        frame = case.match["frame"]
        return Finding(
            "matching",
            frame,
            confidence,
            summary,
            tuple(f"frame {frame}: {event}" for event in events),
            focus=focus,
            decision=decision,
        )


def _score(
    scores: Mapping[str, float], options: Mapping[str, Any], target: Mapping[str, Any]
) -> float | None:
    """What the score should be; None where it says too little."""
    if "score" not in scores or "s_graph" not in scores:
        return None
    guessed = options.get("guessed", 1.0) if target.get("kind") == "implicit" else 1.0
    weights = {
        term: options[name] * (guessed if term == "s_relation" else 1.0) for term, name in WEIGHTS.items()
    }
    return float(scores["s_graph"] + sum(weight * scores.get(term, 0.0) for term, weight in weights.items()))


def _core(case: EpisodeCase) -> str:
    return str(case.match["target"]["core"]) if case.match else ""


def _there(case: EpisodeCase, frame: int) -> list[ObjectHistory]:
    """Objects of the map that are called what the target graph asks for and are seen from a viewpoint."""
    history = case.recording.history
    return [
        thing
        for thing in history.objects.values()
        if thing.is_there(frame)
        and same_thing(thing.label(frame), [case.core])
        and history.seen_from(thing.id, frame)
    ]


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`matching`: the target graph against the map."""
    register("matching", MatchingRule, config=Config)
