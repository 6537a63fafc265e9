"""Why an episode went wrong: rules say what speaks against which layer, the strongest evidence names it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from dssmsg.checks import check_findings
from dssmsg.interfaces import Diagnosis
from dssmsg.interfaces.diagnosis import LAYERS, Finding
from dssmsg.review.episode import EpisodeCase, ReviewedRecording

FAULT, CANNOT_TELL, NO_FAULT, NOT_BEGUN = "fault", "cannot tell", "no fault", "not begun"
_BUDGET = "mission.max_frames"
SURE = 0.55
"""A finding less sure than this names nobody."""
VERY_SURE = 0.8
"""So sure a finding must be to doubt an episode that ended well by all that is recorded."""
_MOST_ROWS = 12


@dataclass(frozen=True, slots=True)
class RuleFinding:
    """A finding, and the rule that made it."""

    rule: str
    finding: Finding


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """What the rules make of an episode.

    verdict `fault` names a `layer`; `cannot tell` has none, whatever the findings hint at; `no fault`: it
    ended well, and nothing speaks against that; `not begun`: the run ended before its turn. `key` of the
    configuration is what ended the run, before or in the episode, if one did. `frame` is the first one
    where things went wrong, `chain` what happened from there to the end, `problems` the rules that failed.
    """

    episode: int
    goal: str
    outcome: str
    reason: str
    mistaken: bool
    with_truth: bool
    """Whether the truth says if it went well."""
    note: str
    verdict: str
    layer: str
    frame: int | None
    sim_time: float | None
    last_frame: int
    findings: tuple[RuleFinding, ...]
    chain: tuple[str, ...]
    problems: tuple[str, ...]
    key: str = ""

    @property
    def lead(self) -> Finding | None:
        """The finding that names the layer."""
        return self.findings[0].finding if self.verdict == FAULT else None


def diagnose(recording: ReviewedRecording, episode: int, rules: Sequence[tuple[str, Diagnosis]]) -> Diagnosed:
    """Ask every rule about an episode; a rule that fails is told of and does no harm.

    The surest finding comes first, of equally sure ones the one of the earlier rule. Raises InputError where
    there is no such episode.
    """
    case = recording.case(episode)
    if case.reason == NOT_BEGUN:
        return _not_begun(case)
    found: list[RuleFinding] = []
    problems: list[str] = []
    for name, rule in rules:
        try:
            found += [RuleFinding(name, one) for one in check_findings(rule.diagnose(recording, episode))]
        except (Exception, SystemExit) as error:
            problems.append(
                f"rule {name} failed: {type(error).__name__}: {' '.join(str(error).split())[:300]}"
            )
    found.sort(key=lambda one: -one.finding.confidence)
    key, note = _note(case)
    needed = SURE if case.failed else VERY_SURE
    borne_out = not case.failed and case.truly_reached is True
    sure = bool(found) and found[0].finding.confidence >= needed and not borne_out
    verdict = FAULT if sure else CANNOT_TELL if case.failed else NO_FAULT
    lead = found[0].finding if sure else None
    frame = None if lead is None else min(max(lead.frame, 0), case.last)
    known = set(recording.frame_indices)
    return Diagnosed(
        episode=episode,
        goal=case.goal,
        outcome=case.outcome,
        reason=case.reason,
        mistaken=case.is_mistaken,
        with_truth=case.is_judged_by_truth,
        note=note,
        verdict=verdict,
        layer="" if lead is None else lead.layer,
        frame=frame,
        sim_time=recording.sim_time(frame) if frame in known else None,
        last_frame=case.last,
        findings=tuple(found),
        chain=() if lead is None else _chain(case, lead),
        problems=tuple(problems),
        key=key,
    )


def _not_begun(case: EpisodeCase) -> Diagnosed:
    """An episode that no rule can say anything of: only how the run ended."""
    key, why = _ending(case.recording)
    return Diagnosed(
        episode=case.number,
        goal=case.goal,
        outcome=case.outcome,
        reason=case.reason,
        mistaken=False,
        with_truth=False,
        note=f"never begun: the run ended at frame {case.last}, {why}",
        verdict=NOT_BEGUN,
        layer="",
        frame=None,
        sim_time=None,
        last_frame=case.last,
        findings=(),
        chain=(),
        problems=(),
        key=key,
    )


def _ending(recording: ReviewedRecording) -> tuple[str, str]:
    """The key that a run was ended by, empty where it was none; and why it ended, in words."""
    if recording.facts.get("parent"):
        return "", "where the recorded run that it replays did"
    if not (recording.stored_summary or {}).get("out_of_frames"):
        return "", "where the source gave no more frames"
    mission = recording.config.get("mission")
    budget = mission.get("max_frames") if isinstance(mission, Mapping) else None
    told = f" ({budget})" if isinstance(budget, int) else ""
    return _BUDGET, f"where {_BUDGET}{told} was used up; raise it"


def _note(case: EpisodeCase) -> tuple[str, str]:
    """The key that cut the episode short, if one did; and what a reader must know beside the findings."""
    if case.reason == "out of time" and case.last == case.recording.frame_indices[-1]:
        key, why = _ending(case.recording)
        if key:
            return key, f"the run ended at frame {case.last}, {why}"
    return "", _circumstance(case)


def _circumstance(case: EpisodeCase) -> str:
    if case.asks_for_nothing_there:
        return f"by the recorded truth there is no {' or '.join(sorted(case.wanted))}: nothing could be found"
    if case.touched is not None:
        return f"the robot touched something at frame {case.touched.frame}"
    return ""


def _chain(case: EpisodeCase, lead: Finding) -> tuple[str, ...]:
    """From the first frame where things went wrong to the end of the episode, one line each."""
    rows: list[str] = []
    before = ""
    for row in case.driving:
        line = f"{row['state']} {row['detail']}".strip()
        if row["frame"] >= lead.frame and line != before:
            rows.append(f"frame {row['frame']}: {line}")
            before = line
    if len(rows) > _MOST_ROWS:
        half = _MOST_ROWS // 2
        rows = [*rows[:half], f"... {len(rows) - _MOST_ROWS} more steps of the drive ...", *rows[-half:]]
    if case.outcome == "success":
        end = "the robot was content" + (", wrongly" if case.is_mistaken else "")
    else:
        end = f"the episode failed: {case.reason}"
    return (*lead.events, *rows, f"frame {case.last}: {end}")


def view_command(path: str, found: Diagnosed) -> str:
    """The command that opens the viewer where things went wrong."""
    lead = found.lead
    frame = found.last_frame if found.frame is None else found.frame
    focus = f" --focus {lead.focus}" if lead is not None and lead.focus else ""
    return f"dssmsg view {path} --at frame={frame}{focus}"


def diagnosed_json(path: str, found: Diagnosed) -> dict[str, Any]:
    """What `explain --episode --json` prints."""
    lead = found.lead
    return {
        "recording": path,
        "episode": found.episode,
        "goal": found.goal,
        "outcome": found.outcome,
        "reason": found.reason,
        "mistaken": found.mistaken,
        "with_truth": found.with_truth,
        "note": found.note,
        "verdict": found.verdict,
        "layer": found.layer or None,
        "confidence": None if lead is None else lead.confidence,
        "basis": None if lead is None else lead.basis,
        "frame": found.frame,
        "sim_time": found.sim_time,
        "key": found.key or None,
        "decision": None if lead is None else _decision(lead),
        "chain": list(found.chain),
        "findings": [_finding(one) for one in found.findings],
        "problems": list(found.problems),
        "view": view_command(path, found),
    }


def _finding(one: RuleFinding) -> dict[str, Any]:
    return {"rule": one.rule, **asdict(one.finding), "decision": _decision(one.finding)}


def _decision(finding: Finding) -> Mapping[str, Any] | None:
    held = finding.decision
    return None if held is None else {**asdict(held), "margin": held.margin}


def diagnosed_text(path: str, found: Diagnosed) -> str:
    """One page for a reader."""
    ended = found.outcome if not found.reason else f"{found.outcome} ({found.reason})"
    if found.mistaken:
        how = "by the recorded truth" if found.with_truth else "by the names it used"
        ended += f", and wrongly so {how}"
    lines = [
        f"episode {found.episode}: {found.goal}",
        f"  ended at frame {found.last_frame}: {ended}",
    ]
    lines += [f"  {found.note}"] if found.note else []
    lead = found.lead
    if lead is not None:
        lines += ["", f"guilty layer: {found.layer} ({LAYERS[found.layer]})", f"  {lead.summary}"]
        lines.append(f"  how sure: {lead.confidence:.2f}, {_basis(lead, found.with_truth)}")
        at = "" if found.sim_time is None else f" ({found.sim_time:.1f} s)"
        lines.append(f"  first went wrong at frame {found.frame}{at}")
        if lead.decision is not None:
            held = lead.decision
            lines.append(
                f"  decided by {held.name} {held.value:.3g} against {held.against:.3g}"
                f" (margin {held.margin:+.3g})"
            )
        lines += ["", "what happened", *(f"  {event}" for event in found.chain)]
    elif found.verdict == NO_FAULT:
        known = (
            "the recorded truth bears it out" if found.with_truth else "nothing in the recording disagrees"
        )
        lines += ["", f"no fault was found: {known}"]
    elif found.verdict != NOT_BEGUN:
        lines += ["", "cannot tell which layer is to blame: no rule is sure enough"]
    others = [one for one in found.findings if one.finding is not lead]
    if others:
        lines += ["", "also seen" if lead is not None else "seen"]
        lines += [
            f"  {one.finding.layer} {one.finding.confidence:.2f} [{one.rule}]: {one.finding.summary}"
            for one in others[:8]
        ]
    lines += ["", *found.problems] if found.problems else []
    return "\n".join([*lines, "", f"look at it: {view_command(path, found)}"])


def _basis(lead: Finding, with_truth: bool) -> str:
    if lead.basis == "truth":
        return "by the recorded truth"
    return "from the recording itself" + (
        "; the recorded truth adds nothing to it" if with_truth else "; no truth is recorded"
    )
