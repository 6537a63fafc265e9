"""diagnosis/association: did the detections of what is asked for become one object, and nothing else's?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, ReviewedRecording, same_thing
from dssmsg.review.episode_map import ObjectHistory, Sighting
from dssmsg.review.episode_truth import by_name, true_parts

LAYER = "association"


class Config(PluginConfig):
    """Options of the rule `association`."""

    min_detections: int = Field(3, ge=2, description="Detections by its name that must have made an object.")
    pieces_share: float = Field(
        0.6,
        gt=0,
        le=1,
        description="A name is in pieces where so large a share of its detections is new objects.",
    )
    foreign_share: float = Field(
        0.3, gt=0, lt=1, description="An object is two where so large a share of it is another thing."
    )


class AssociationRule:
    """Follows the detections of the sought name into the map."""

    def __init__(self, config: Config) -> None:
        self._config = config

    def diagnose(self, recording: ReviewedRecording, episode: int | None) -> Sequence[Finding]:
        """Findings: in pieces, swallowed by something else, two in one."""
        if episode is None:
            return ()
        case = recording.case(episode)
        if not case.wanted:
            return ()
        return [*self._lost(case), *self._mixed(case)]

    def _lost(self, case: EpisodeCase) -> Iterator[Finding]:
        """Detected by its name, yet no believed object of that name before the goal was grounded."""
        at = case.before if case.match is None else case.match["frame"]
        things = case.recording.history.objects.values()
        mine = [
            (t, s) for t in things for s in t.sightings if s.frame <= at and same_thing(s.label, case.wanted)
        ]
        unique = {(s.frame, s.detection): (t, s) for t, s in mine}
        if len(unique) < self._config.min_detections:
            return
        if any(t.is_there(at) and same_thing(t.label(at), case.wanted) for t in things):
            return
        if any(
            t.value("state", at) == "disappeared" and same_thing(t.label(at), case.wanted) for t in things
        ):
            return  # the update's doing
        swallowed = [(t, s) for t, s in unique.values() if not same_thing(t.label(at), case.wanted)]
        pieces = sum(s.rule == "new" or s.frame == t.added for t, s in unique.values())
        what = " or ".join(sorted(case.wanted))
        if len(swallowed) >= 0.5 * len(unique):
            yield _swallowed(case, swallowed, len(unique), what)
        elif pieces >= self._config.pieces_share * len(unique):
            first = min((s for _, s in unique.values()), key=lambda s: s.frame)
            ids = sorted({t.id for t, _ in unique.values()})
            yield Finding(
                LAYER,
                first.frame,
                0.85,
                f"{len(unique)} detections of a {what} became {pieces} objects, none of which was believed",
                tuple(
                    f"frame {s.frame}: {t.id} was added for a {s.label}" for t, s in list(unique.values())[:4]
                ),
                focus=ids[0],
                decision=Decision(
                    "share of detections that made new objects",
                    pieces / len(unique),
                    self._config.pieces_share,
                ),
            )

    def _mixed(self, case: EpisodeCase) -> Iterator[Finding]:
        """What was taken for the target holds two things."""
        held = case.held
        if held is None or len(held.sightings) < self._config.min_detections:
            return
        if case.answers:
            parts = true_parts(case.recording, held)
            total = sum(parts.values())
            if len(parts) < 2 or total < self._config.min_detections:
                return
            (main, _), (other, count) = parts.most_common(2)
            labels = {thing.label for name, thing in by_name(case.things).items() if name in (main, other)}
            share = count / total
            if share >= self._config.foreign_share and any(
                same_thing(label, case.wanted) for label in labels
            ):
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
        if other and count / total >= self._config.foreign_share:
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


def _swallowed(
    case: EpisodeCase, swallowed: Sequence[tuple[ObjectHistory, Sighting]], total: int, what: str
) -> Finding:
    first_thing, first = min(swallowed, key=lambda pair: pair[1].frame)
    into = Counter(thing.id for thing, _ in swallowed).most_common(1)[0][0]
    thing = case.recording.history.objects[into]
    return Finding(
        LAYER,
        first.frame,
        0.85,
        f"{len(swallowed)} of {total} detections of a {what} were put into objects of other names,"
        f" most of them into {into} ({thing.label()})",
        tuple(
            f"frame {s.frame}: a {s.label} was put into {t.id} ({t.label()}) {_told(s)}"
            for t, s in swallowed[:4]
        ),
        focus=first_thing.id,
        decision=Decision("share of its detections in objects of other names", len(swallowed) / total, 0.5),
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
    register("association", lambda config, context: AssociationRule(config), config=Config)
