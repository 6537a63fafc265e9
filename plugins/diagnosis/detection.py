"""diagnosis/detection: was what is asked for detected where it was in view, and under its name?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import Decision, Finding
from dssmsg.review.episode import EpisodeCase, same_thing
from dssmsg.review.episode_rule import EpisodeRule
from dssmsg.review.episode_truth import by_name, true_name, true_sights

LAYER = "detector"


class Config(PluginConfig):
    """Options of the rule `detection`."""

    min_views: int = Field(
        3, ge=1, description="Key frames that must truly show the target to judge by them."
    )
    found_share: float = Field(
        0.5, gt=0, le=1, description="In this share of them at least it must be detected by its name."
    )
    never_confidence: float = Field(
        0.65, ge=0, le=1, description="How sure, without truth, where nothing was ever called what is sought."
    )


class DetectionRule(EpisodeRule[Config]):
    """By the truth: the key frames that show an answer. Without: was its name ever given to anything?"""

    def findings(self, case: EpisodeCase) -> Sequence[Finding]:
        """At most two findings: the target missed or misnamed; something else given its name."""
        if not case.wanted or not case.recording.key_frames:
            return ()
        if case.answers:
            return [*self._missed(case), *self._misnamed(case)]
        return () if case.asks_for_nothing_there else [*self._never(case)]

    def _missed(self, case: EpisodeCase) -> Iterator[Finding]:
        """Key frames that truly show an answer, without a detection by its name."""
        sights = true_sights(case)
        frames = sorted({sight.frame for sight in sights})
        if len(frames) < self.config.min_views:
            return
        good = {s.frame for s in sights if any(same_thing(name, case.wanted) for name in s.names)}
        share = len(good) / len(frames)
        if share >= self.config.found_share:
            return
        names = Counter(n for s in sights for n in s.names if not same_thing(n, case.wanted))
        called = ", ".join(f"{name} {count} times" for name, count in names.most_common(3))
        what = " or ".join(sorted(case.wanted))
        yield Finding(
            LAYER,
            next(frame for frame in frames if frame not in good),
            min(0.95, 0.6 + 0.4 * (1 - share / self.config.found_share)),
            f"a {what} was truly in view in {len(frames)} key frames and detected as such in {len(good)}"
            + (f"; it was called {called}" if names else "; nothing was detected there"),
            tuple(
                f"frame {s.frame}: in view, "
                + (f"called {', '.join(s.names)}" if s.names else "not detected")
                for s in sights[:4]
            ),
            decision=Decision(
                "share of key frames that show it with a detection", share, self.config.found_share
            ),
            basis="truth",
        )

    def _misnamed(self, case: EpisodeCase) -> Iterator[Finding]:
        """What was taken for the target is truly something else, and detections gave it the name."""
        held = case.held
        if held is None or not same_thing(held.label(case.last), case.wanted):
            return
        truth = by_name(case.things)
        wrong, asked = [], 0
        for sighting in held.sightings[:40]:
            name = true_name(case.recording, sighting.frame, sighting.detection)
            if name not in truth:
                continue
            asked += 1
            if same_thing(sighting.label, case.wanted) and not same_thing(truth[name].label, case.wanted):
                wrong.append((sighting, name))
        if asked < self.config.min_views or len(wrong) < 0.5 * asked:
            return
        first, name = wrong[0]
        yield Finding(
            LAYER,
            first.frame,
            0.9,
            f"{held.id} was taken for the target, but {len(wrong)} of its {asked} detections called"
            f" {name} ({truth[name].label}) a {first.label}",
            tuple(f"frame {s.frame}: {n} was called {s.label}" for s, n in wrong[:4]),
            focus=held.id,
            decision=Decision("share of its detections that were misnamed", len(wrong) / asked, 0.5),
            basis="truth",
        )

    def _never(self, case: EpisodeCase) -> Iterator[Finding]:
        """No detection was ever called what is sought; the map cannot hold it then."""
        named = sum(n for label, n in case.recording.labels.items() if same_thing(label, case.wanted))
        if named or not case.recording.labels or not same_thing(case.core, case.wanted):
            return
        what = " or ".join(sorted(case.wanted))
        frames = len(case.recording.key_frames)
        yield Finding(
            LAYER,
            case.recording.key_frames[0],
            self.config.never_confidence,
            f"nothing in {frames} key frames was called {what}: it was missed or misnamed, or there is none",
            (f"frame {case.recording.key_frames[0]}: the first of {frames} key frames without a {what}",),
            decision=Decision(f"detections called {what}", 0.0, 1.0),
        )


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`detection`: what is in view against what was detected."""
    register("detection", DetectionRule, config=Config)
