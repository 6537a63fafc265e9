"""diagnosis/update: was the map brought up to date: what went taken out, what stayed left in?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pydantic import Field

from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.graph.verdicts import MISSED, PRESENT, SEEN
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, same_thing
from dssmsg.review.episode_map import Fact, ObjectHistory
from dssmsg.review.episode_rule import EpisodeRule
from dssmsg.review.episode_truth import gap_to

LAYER = "update"


class Config(PluginConfig):
    """Options of the rule `update`."""

    frames: int = Field(3, ge=1, description="Key frames in a row that must say one thing of an object.")
    apart: float = Field(
        0.5, gt=0, description="An object this far from every true one is out of place, metres."
    )


class UpdateRule(EpisodeRule[Config]):
    """Holds verdicts on the sought objects against the evidence of the windows, and against the truth."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """Findings: called gone though it is there; left in though it is gone."""
        if not case.wanted:
            return ()
        return [*self._called_gone(case), *self._left_in(case)]

    def _called_gone(self, case: EpisodeCase) -> Iterator[Finding]:
        """A sought object was called gone, though frames around then, or the truth, show it in its place."""
        for thing in case.recording.history.named(case.recording.labels):
            if not same_thing(thing.label(), case.wanted):
                continue
            verdict = _gone_at(thing, case.last)
            if verdict is None:
                continue
            if case.answers:
                near = [a for a in case.answers if gap_to(a, thing.box) < self.config.apart / 2]
                if near and near[0].state not in ("moved", "appeared"):
                    yield self._finding(
                        thing, verdict, 0.9, f"{near[0].name} truly stands in its place", (), truth=True
                    )
                continue
            missed = _frames(case, thing.id, (MISSED,), verdict.frame)
            shown = [f for f in _frames(case, thing.id, (SEEN, PRESENT), case.last) if f >= verdict.frame]
            if len(missed) < self.config.frames:
                counted = f"only {len(missed)} key frames showed its place free"
                yield self._finding(thing, verdict, 0.85, counted, shown, held=float(len(missed)))
            elif len(shown) >= self.config.frames:
                yield self._finding(
                    thing, verdict, 0.7, f"{len(shown)} later key frames showed it in its place", shown
                )

    def _finding(
        self,
        thing: ObjectHistory,
        verdict: Fact,
        confidence: float,
        why: str,
        shown: Sequence[int],
        *,
        truth: bool = False,
        held: float | None = None,
    ) -> Finding:
        events = [f"frame {verdict.frame}: {thing.id} ({thing.label()}) was called gone by {verdict.cause}"]
        events += [f"frame {frame}: it was seen in its place" for frame in shown[:3]]
        return Finding(
            LAYER,
            verdict.frame,
            confidence,
            f"{thing.id} ({thing.label()}) was called gone, but {why}",
            tuple(events),
            focus=thing.id,
            decision=None
            if held is None
            else Decision("key frames that showed its place free", held, float(self.config.frames)),
            basis="truth" if truth else "recording",
        )

    def _left_in(self, case: EpisodeCase) -> Iterator[Finding]:
        """A sought object is in the map when the goal is grounded, though frames had shown it gone."""
        if case.match is None:
            return
        at = case.match["frame"]
        driven = case.held if any(row["state"] == "missing" for row in case.driving) else None
        for thing in case.recording.history.objects.values():
            if not thing.is_there(at) or not same_thing(thing.label(at), case.wanted):
                continue
            if any(gap_to(answer, thing.box) < self.config.apart for answer in case.answers):
                continue  # it is there, whatever the windows say: they need not be read
            missed = _frames(case, thing.id, (MISSED,), at)
            if len(missed) < self.config.frames:
                continue
            sure = 0.8 if driven is thing else 0.7
            yield Finding(
                LAYER,
                missed[self.config.frames - 1],
                sure + (0.1 if case.things else 0.0),
                f"{thing.id} ({thing.label()}) was still in the map, though {len(missed)} frames had shown"
                " its place free before the goal was sought",
                tuple(f"frame {frame}: its place was shown free" for frame in missed[:4]),
                focus=thing.id,
                decision=Decision(
                    "key frames that showed its place free", float(len(missed)), float(self.config.frames)
                ),
                basis="truth" if case.things else "recording",
            )


def _gone_at(thing: ObjectHistory, last: int) -> Fact | None:
    """The fact that called an object gone, where that still held at a frame."""
    facts = [fact for fact in thing.facts if fact.name == "state" and fact.frame <= last]
    return facts[-1] if facts and facts[-1].value == DISAPPEARED else None


def _frames(case: EpisodeCase, object_id: str, verdicts: Sequence[str], until: int) -> list[int]:
    """Key frames that said so of an object, each once, ascending; since the last that said otherwise."""
    said = case.evidence.get(object_id, {})
    run: list[int] = []
    for frame in sorted(frame for frame in said if frame <= until):
        if said[frame] in verdicts:
            run.append(frame)
        elif said[frame] in (SEEN, PRESENT, MISSED):
            run = []
    return run


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`update`: verdicts on objects against their evidence."""
    register("update", UpdateRule, config=Config)
