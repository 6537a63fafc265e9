"""diagnosis/language: did the sentence become a target graph, and one that asks for what it says?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Finding
from dssmsg.review.episode import EpisodeCase, same_thing, words_of
from dssmsg.review.episode_rule import EpisodeRule

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

NO_TARGET = "no target graph"


class Config(PluginConfig):
    """Options of the rule `language`."""

    reread: bool = Field(True, description="Whether the offline tables read the sentence once more.")
    reread_confidence: float = Field(
        0.7, ge=0, le=1, description="How sure, where only the second reading speaks against the first."
    )


class LanguageRule(EpisodeRule[Config]):
    """Holds the target graph against the sentence, by its own words and by the offline tables."""

    def __init__(self, config: Config, context: Context | None = None) -> None:
        super().__init__(config, context)
        self._targets: Any = None

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """At most one finding."""
        if case.match is None:
            return [_no_target(case)] if case.reason == NO_TARGET else ()
        core, words = words_of(case.core), words_of(case.goal)
        if any(words[i : i + len(core)] == core for i in range(len(words))):
            named_first = same_thing(case.core, case.wanted)
            if named_first or not case.names_its_goal:
                return ()
        elif case.names_its_goal and not same_thing(case.core, case.wanted):
            return [_finding(case, 0.9, f"the goal names {_any(case.wanted)}")]
        read = self._reading(case.goal)
        if read is None or same_thing(case.core, [read["nodes"][read["core"]]["label"]]):
            return ()
        named = {node["label"] for node in read["nodes"]} & {
            n["label"] for n in case.match["target"]["nodes"]
        }
        sure = self.config.reread_confidence * (0.6 if named else 1.0)
        label = read["nodes"][read["core"]]["label"]
        return [_finding(case, sure, f"the offline tables read {label} in it")]

    def _reading(self, goal: str) -> Mapping[str, Any] | None:
        """The target graph of the offline tables; None where they understand nothing."""
        if not self.config.reread:
            return None
        from dssmsg.lexicon.tables import load_tables
        from dssmsg.lexicon.target import NoTarget, Targets

        if self._targets is None:
            self._targets = Targets(load_tables(), None)
        try:
            found: Mapping[str, Any] = self._targets.of(goal)
        except NoTarget:
            return None
        return found


def _no_target(case: EpisodeCase) -> Finding:
    failed = [call for call in case.calls if not call["ok"]]
    why = failed[-1]["error"] if failed else "the language model gave none"
    return Finding(
        "grounding",
        max(case.before, 0),
        0.95,
        f"the goal became no target graph: {why}",
        tuple(f"frame {c['frame']}: {c['provider']} failed: {c['error']}" for c in failed[:5]),
    )


def _finding(case: EpisodeCase, confidence: float, instead: str) -> Finding:
    assert case.match is not None
    nodes = ", ".join(node["label"] for node in case.match["target"]["nodes"])
    answer = next((call["answer"] for call in reversed(case.calls) if call["ok"]), "")
    events = [f"frame {case.match['frame']}: target graph: core {case.core}, nodes {nodes}"]
    if answer:
        events.insert(0, f"frame {case.match['frame']}: the language model answered {answer[:200]}")
    return Finding(
        "grounding",
        case.match["frame"],
        confidence,
        f"the target graph asks for {case.core}, but {instead}",
        tuple(events),
    )


def _any(labels: frozenset[str]) -> str:
    return " or ".join(sorted(labels))


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`language`: the sentence against its target graph."""
    register("language", LanguageRule, config=Config)
