"""Everything that the tables need of one method on one recorded home, as a value that is kept as JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dssmsg.errors import ConfigError, InputError
from dssmsg.evaluate.dynamic import (
    Claim,
    Tally,
    Thing,
    UpdateScore,
    dynamic_tally,
    fits,
    full_tally,
    split_moves,
    static_tally,
    update_score,
)
from dssmsg.evaluate.dynamic_states import GraphWatch, Snapshot, States, claims_of, survey_claims
from dssmsg.evaluate.dynamic_truth import PUT_BACK, RunTruth
from dssmsg.evaluate.fig5 import Recovery, recovery
from dssmsg.graph.nodes import APPEARED, DISAPPEARED, MOVED, STATIC

SWAP = "swap"


@dataclass(frozen=True, slots=True)
class Verdicts:
    """How many of some cases came out right; `failed` names the others."""

    right: int
    failed: tuple[str, ...]

    @property
    def cases(self) -> int:
        """How many there were."""
        return self.right + len(self.failed)


@dataclass(frozen=True, slots=True)
class ReplayScore:
    """One method on one case. `recording` is relative to the work folder; `seconds` the replay's wall time.

    `still_there` counts the static things that the survey's map had, `hidden` those of them that nothing
    showed afterwards; their failures are what the map calls disappeared.
    """

    scene: str
    seed: int
    perception: str
    method: str
    recording: str
    seconds: float
    errors: int
    static: Tally
    dynamic: Tally
    dynamic_split: Tally
    appear: Tally
    disappear: Tally
    relocation: Tally
    full: Tally
    update: UpdateScore
    recovery: Recovery
    first_revisit: float
    """Relative accuracy at the end of the first revisit."""
    still_there: Verdicts
    hidden: Verdicts
    swap: Verdicts
    put_back: Verdicts

    def write(self, file: Path) -> None:
        """Whole or not at all: a score is what marks a replay as done."""
        draft = file.with_suffix(".tmp")
        draft.write_text(json.dumps(asdict(self), indent=1) + "\n", "utf-8")
        draft.replace(file)

    @classmethod
    def read(cls, file: Path) -> ReplayScore:
        """A kept score; ConfigError where the file is not one."""
        try:
            stored = json.loads(file.read_text("utf-8"))
            return cls(**{key: _revived(key, value) for key, value in stored.items()})
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigError("is no result of this evaluation; remove it", file=file) from error


def score_replay(watch: GraphWatch, truth: RunTruth, states: States, **facts: Any) -> ReplayScore:
    """Score what was watched; `facts` are the fields that say what it was. InputError without a revisit."""
    survey = watch.survey
    if survey is None:
        raise InputError("the replay ended before its revisit began", key="source.recording")
    last = watch.updates[-1] if watch.updates else survey
    before, after = survey_claims(survey), claims_of(last, survey, states)
    split_claims, split_things = split_moves(after, truth.after)
    recovered = recovery(survey, watch.updates, truth, states)
    first = watch.visit_ends[0] if watch.visit_ends else len(watch.updates)
    return ReplayScore(
        static=static_tally(after, truth.after),
        dynamic=dynamic_tally(after, truth.after),
        dynamic_split=dynamic_tally(split_claims, split_things),
        appear=dynamic_tally(after, truth.after, [APPEARED]),
        disappear=dynamic_tally(after, truth.after, [DISAPPEARED]),
        relocation=dynamic_tally(after, truth.after, [MOVED]),
        full=full_tally(after, truth.after),
        update=update_score(before, after, truth.after),
        recovery=recovered,
        first_revisit=recovered.relative[first - 1] if first and recovered.measurable else 0.0,
        still_there=_still_there(before, after, truth.after, hidden=False),
        hidden=_still_there(before, after, truth.after, hidden=True),
        swap=_swaps(after, truth.after),
        put_back=_put_backs(survey, last, truth),
        **facts,
    )


def _still_there(
    before: Sequence[Claim], after: Sequence[Claim], things: Sequence[Thing], *, hidden: bool
) -> Verdicts:
    """Static things that the survey's map had: which are called disappeared? `hidden`: of the unseen ones."""
    gone = [claim for claim in after if claim.state == DISAPPEARED]
    known = [
        thing
        for thing in things
        if thing.state == STATIC
        and fits(before, thing.place).any()
        and not (
            hidden and any(thing.place.visits.get(visit, 0) for visit in thing.place.visits if visit > 0)
        )
    ]
    failed = tuple(thing.name for thing in known if fits(gone, thing.place).any())
    return Verdicts(len(known) - len(failed), failed)


def _seen_later(thing: Thing) -> bool:
    """Whether a frame after the survey showed it."""
    return any(count for visit, count in thing.place.visits.items() if visit > 0)


def _swaps(after: Sequence[Claim], things: Sequence[Thing]) -> Verdicts:
    """Things that changed places: right where each is said to have moved from its own to the other's."""
    swapped = [thing for thing in things if thing.tag == SWAP and thing.counted and thing.state == MOVED]
    others = [thing for thing in things if thing not in swapped]
    missed = dynamic_tally(after, [*swapped, *others], [MOVED]).missed
    failed = tuple(thing.name for thing in swapped if thing.name in missed)
    return Verdicts(len(swapped) - len(failed), failed)


def _put_backs(survey: Snapshot, last: Snapshot, truth: RunTruth) -> Verdicts:
    """Things that are back: right where the same object is there as before, and none where it was."""
    before, after = survey_claims(survey), claims_of(last, survey, "graph")
    there = [claim for claim in after if claim.present]
    right, failed = 0, []
    for thing in truth.after:
        if thing.tag != PUT_BACK or thing.name not in truth.away:
            continue
        known = [claim for claim, fit in zip(before, fits(before, thing.place), strict=True) if fit]
        if not known:
            continue
        back = [claim for claim, fit in zip(there, fits(there, thing.place), strict=True) if fit]
        same = len(back) == 1 and back[0].id in {claim.id for claim in known}
        ghosts = any(fits(there, place).any() for place in truth.away[thing.name])
        if same and not ghosts:
            right += 1
        else:
            failed.append(thing.name)
    return Verdicts(right, tuple(failed))


_PARTS: dict[str, Any] = {
    **dict.fromkeys(
        ("static", "dynamic", "dynamic_split", "appear", "disappear", "relocation", "full"), Tally
    ),
    **dict.fromkeys(("still_there", "hidden", "swap", "put_back"), Verdicts),
    "update": UpdateScore,
    "recovery": Recovery,
}


def _revived(key: str, value: Any) -> Any:
    if key not in _PARTS:
        return value
    return _PARTS[key](**{k: tuple(v) if isinstance(v, list) else v for k, v in value.items()})
