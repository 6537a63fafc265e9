"""diagnosis/errors: recorded failures of plug-ins; the layers that they work in, worst first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import Field

from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces.diagnosis import BLAME, Finding


class Config(PluginConfig):
    """Options of the rule `errors`."""

    shown: int = Field(5, ge=1, description="How many messages of each plug-in a finding quotes.")


class ErrorsRule:
    """One finding a failed plug-in. How sure: 1 if it ended the run, else half its share of all."""

    def __init__(self, config: Config) -> None:
        self._shown = config.shown

    def diagnose(self, recording: Any, episode: int | None) -> Sequence[Finding]:
        """Findings over the whole recording, or over one episode (since the end of the one before)."""
        first, last = _span(recording, episode)
        errors = [error for error in recording.errors() if first <= error["frame"] <= last]
        by_plugin: dict[str, list[dict[str, Any]]] = {}
        for error in errors:
            by_plugin.setdefault(error["plugin"], []).append(error)
        findings = []
        for plugin, own in by_plugin.items():
            layer = BLAME.get(plugin.partition("/")[0])
            if layer is None:  # an observer, or the mission: neither sees nor drives
                continue
            fatal = any(error["fatal"] for error in own)
            skipped = sum(bool(error["skipped"]) for error in own)
            confidence = 1.0 if fatal else 0.5 * len(own) / len(errors)
            consequence = "ended the run" if fatal else f"skipped work {skipped} times"
            times = "once" if len(own) == 1 else f"{len(own)} times"
            findings.append(
                Finding(
                    layer=layer,
                    frame=own[0]["frame"],
                    confidence=confidence,
                    summary=f"{plugin} failed {times} and {consequence}: {own[0]['message']}",
                    events=tuple(f"frame {e['frame']}: {e['message']}" for e in own[: self._shown]),
                )
            )
        return sorted(findings, key=lambda finding: (-finding.confidence, finding.frame, finding.summary))


def _span(recording: Any, episode: int | None) -> tuple[float, float]:
    """First and last frame that an episode covers; everything without one or for an unknown one."""
    before = float("-inf")
    for ended in recording.episodes() if episode is not None else ():
        if ended["episode"] == episode:
            return before + 1, ended["frame"]
        before = ended["frame"]
    return float("-inf"), float("inf")


@hookimpl
def register_diagnosis(register: Register) -> None:
    """`errors`: failures that were recorded."""
    register("errors", lambda config, context: ErrorsRule(config), config=Config)
