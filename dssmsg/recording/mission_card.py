"""What the robot is about, as a page for the viewer: phase, goal, driver's state, episodes so far."""

from __future__ import annotations

from dssmsg import events

EPISODES_SHOWN = 8


class MissionCard:
    """Told the events of a mission, it says what the page then shows. Keeps a few lines, whatever the run."""

    def __init__(self) -> None:
        self._phase = ""
        self._goal = ""
        self._target = ""
        self._state = ""
        self._path: tuple[str, ...] = ()
        self._ended: list[str] = []
        self._successes = 0
        self._episodes = 0

    def phase_started(self, event: events.PhaseStarted) -> None:
        """A phase begins; what was aimed at before is over."""
        self._phase = f"{event.phase}, visit {event.visit}"
        self._goal = self._target = self._state = ""
        self._path = ()

    def matched(self, event: events.Matched) -> None:
        """A goal was grounded."""
        self._goal = event.query
        if event.candidates:
            best = event.candidates[0]
            self._target = f"{best.viewpoint_id}" + (f" ({best.reason})" if best.reason else "")
        else:
            self._target = "nothing matches"

    def navigation_changed(self, event: events.NavigationChanged) -> None:
        """The driver does something else."""
        self._state = f"{event.state}: {event.detail}" if event.detail else event.state
        self._path = event.path

    def episode_ended(self, event: events.EpisodeEnded) -> None:
        """A goal was reached or given up."""
        self._episodes += 1
        self._successes += event.outcome == "success"
        reason = f" ({event.reason})" if event.reason else ""
        self._ended.append(f"“{event.goal}”: **{event.outcome}**{reason}")
        del self._ended[:-EPISODES_SHOWN]
        self._goal = self._target = self._state = ""
        self._path = ()

    def text(self) -> str:
        """The page, in Markdown."""
        parts = [f"## {self._phase or 'not begun'}"]
        if self._goal:
            parts.append(f"**goal** “{self._goal}”")
            parts.append(f"**best place** {self._target}")
        if self._state:
            parts.append(f"**driver** {self._state}")
        if self._path:
            parts.append(f"**way** {' → '.join(name.removeprefix('waypoint-') for name in self._path)}")
        if self._episodes:
            parts.append(f"**episodes** {self._successes} of {self._episodes} succeeded")
            parts.append("\n".join(f"- {line}" for line in self._ended))
        return "\n\n".join(parts) + "\n"
