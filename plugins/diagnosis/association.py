"""diagnosis/association: did the detections of what is asked for become one object, and nothing else's?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from pydantic import Field

from dssmsg.graph.nodes import DISAPPEARED
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, same_thing
from dssmsg.review.episode_map import ObjectHistory, Sighting
from dssmsg.review.episode_rule import EpisodeRule
from dssmsg.review.episode_truth import by_name, true_name, true_parts

LAYER = "association"
Put = tuple[ObjectHistory, Sighting]
"""A detection, and the object that it was put into."""


class Config(PluginConfig):
    """Options of the rule `association`."""

    min_detections: int = Field(
        3, ge=2, description="Detections by its name from which on their objects are judged."
    )
    pieces_share: float = Field(
        0.6,
        gt=0,
        le=1,
        description="A name is in pieces where so large a share of its detections is new objects.",
    )
    foreign_share: float = Field(
        0.3, gt=0, lt=1, description="An object is two where so large a share of it is another thing."
    )


class AssociationRule(EpisodeRule[Config]):
    """Follows the detections of the sought name into the map."""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """Findings: in pieces, swallowed by something else, two in one."""
        if not case.wanted:
            return ()
        return [*self._lost(case), *self._mixed(case)]

    def _lost(self, case: EpisodeCase) -> Iterator[Finding]:
        """Detected by its name, yet no object of that name could be found when the goal was grounded."""
        at = case.before if case.match is None else case.match["frame"]
        history = case.recording.history
        # What was joined to another object is told of in that one.
        things = [t for t in history.objects.values() if t.added <= at and (t.gone is None or at < t.gone)]
        named = [t for t in things if same_thing(t.label(at), case.wanted)]
        if any(t.value("state", at) == DISAPPEARED for t in named):
            return  # the update's doing
        mine = {
            (s.frame, s.detection): (t, s)
            for t in things
            for s in t.sightings
            if s.frame <= at and same_thing(s.label, case.wanted)
        }
        swallowed = [(t, s) for t, s in mine.values() if t not in named]
        made = [(t, next(s for s in t.sightings if same_thing(s.label, case.wanted))) for t in named]
        if any(t.is_there(at) and history.seen_from(t.id, at) for t in named):
            # One that can be found does not make up for a heap of pieces in its place.
            if len(_heap(made)) > self.config.min_detections and self._are_pieces(made, mine):
                yield self._pieces(case, made, len(mine), 0.7)
        elif 2 * len(swallowed) >= len(mine) > 0:
            if len(mine) >= self.config.min_detections:
                yield _swallowed(case, swallowed, len(mine), 0.85)
            elif truly := [(t, s) for t, s in swallowed if _is_answer(case, s)]:
                yield _swallowed(case, truly, len(mine), 0.8, truth=True)
        elif self._are_pieces(made, mine):
            if len(mine) >= self.config.min_detections:
                yield self._pieces(case, made, len(mine), 0.85)
            elif len(_heap(made)) > 1:
                yield self._pieces(case, made, len(mine), 0.65)

    def _are_pieces(self, made: Sequence[Put], mine: Mapping[tuple[int, int], Put]) -> bool:
        return len(made) > 1 and len(made) >= self.config.pieces_share * len(mine)

    def _pieces(self, case: EpisodeCase, made: Sequence[Put], total: int, confidence: float) -> Finding:
        what = " or ".join(sorted(case.wanted))
        first_thing, first = min(made, key=lambda put: put[1].frame)
        return Finding(
            LAYER,
            first.frame,
            confidence,
            f"{total} detections of a {what} became {len(made)} objects",
            tuple(f"frame {s.frame}: {t.id} was added for a {s.label}" for t, s in made[:4]),
            focus=first_thing.id,
            decision=Decision(
                "share of detections that made new objects", len(made) / total, self.config.pieces_share
            ),
        )

    def _mixed(self, case: EpisodeCase) -> Iterator[Finding]:
        """What was taken for the target holds two things."""
        held = case.held
        if held is None or len(held.sightings) < self.config.min_detections:
            return
        if case.answers:
            parts = true_parts(case.recording, held)
            total = sum(parts.values())
            if len(parts) < 2 or total < self.config.min_detections:
                return
            (main, _), (other, count) = parts.most_common(2)
            labels = {thing.label for name, thing in by_name(case.things).items() if name in (main, other)}
            share = count / total
            if share >= self.config.foreign_share and any(same_thing(label, case.wanted) for label in labels):
                yield self._two(case, held, f"{main} and {other}", share, 0.85, truth=True)
            return
        votes = held.votes(case.last)
        total = sum(votes.values())
        label = held.label(case.last)
        other, count = (
            Counter({n: c for n, c in votes.items() if n != label}).most_common(1)[0]
            if len(votes) > 1
            else ("", 0)
        )
        if other and count / total >= self.config.foreign_share:
            yield self._two(case, held, f"{label} and {other}", count / total, 0.6, truth=False)

    @staticmethod
    def _two(
        case: EpisodeCase, held: ObjectHistory, what: str, share: float, confidence: float, *, truth: bool
    ) -> Finding:
        labels = held.label(case.last)
        first = next((s for s in held.sightings if s.label != labels), held.sightings[0])
        return Finding(
            LAYER,
            first.frame,
            confidence,
            f"{held.id}, which was taken for the target, is two things in one: {what}",
            (f"frame {first.frame}: a {first.label} was put into {held.id} {_told(first)}",),
            focus=held.id,
            decision=Decision("share of it that is the other thing", share, 0.0),
            basis="truth" if truth else "recording",
        )


def _heap(made: Sequence[Put]) -> list[Put]:
    """The most of these new objects that lie in one place: each touches the first of them."""
    return max(
        ([other for other in made if _touch(one[1].box, other[1].box)] for one in made), key=len, default=[]
    )


def _touch(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two boxes (low x, y, z, high x, y, z) have a point in common."""
    return all(a[i] <= b[i + 3] and b[i] <= a[i + 3] for i in range(3))


def _is_answer(case: EpisodeCase, sighting: Sighting) -> bool:
    name = true_name(case.recording, sighting.frame, sighting.detection)
    return name in by_name(case.answers)


def _swallowed(
    case: EpisodeCase, swallowed: Sequence[Put], total: int, confidence: float, *, truth: bool = False
) -> Finding:
    first_thing, first = min(swallowed, key=lambda put: put[1].frame)
    into = Counter(thing.id for thing, _ in swallowed).most_common(1)[0][0]
    thing, what = case.recording.history.objects[into], " or ".join(sorted(case.wanted))
    return Finding(
        LAYER,
        first.frame,
        confidence,
        f"{len(swallowed)} of {total} detections of a {what} were put into objects of other names,"
        f" most of them into {into} ({thing.label()})",
        tuple(
            f"frame {s.frame}: a {s.label} was put into {t.id} ({t.label()}) {_told(s)}"
            for t, s in swallowed[:4]
        ),
        focus=first_thing.id,
        decision=Decision("share of its detections in objects of other names", len(swallowed) / total, 0.5),
        basis="truth" if truth else "recording",
    )


def _told(sighting: Sighting) -> str:
    terms = ", ".join(
        f"{name} {value:.2f}" + ("" if against is None else f" against {against:g}")
        for name, (value, against) in sighting.scores.items()
    )
    return f"({sighting.rule}: {terms})" if terms else f"({sighting.rule})"


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`association`: detections against the objects that they made."""
    register("association", AssociationRule, config=Config)
