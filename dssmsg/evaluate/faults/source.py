"""What faults of wheels and sensors share: a source in between that strikes from a visit on."""

from __future__ import annotations

from dssmsg.evaluate.faults.host import Aim
from dssmsg.frame import Frame
from dssmsg.interfaces import Command, Context, Source, SourceInfo


class BetweenSource:
    """Passes commands in and frames out; `command_in` and `frame_out` are what a fault overrides."""

    def __init__(self, inner: Source, context: Context, aim: Aim) -> None:
        self.inner = inner
        self.context = context
        self.aim = aim
        self.strikes = False
        self.since = 0
        """Frames since it began to strike."""

    @property
    def info(self) -> SourceInfo:
        """The inner one's."""
        return self.inner.info

    def start_visit(self, visit: int) -> None:
        """As the inner one; from the visit of the onset on it strikes."""
        self.inner.start_visit(visit)
        self.strikes = visit >= self.aim.onset

    def step(self, command: Command | None) -> Frame | None:
        """One period with the fault."""
        if not self.strikes:
            return self.inner.step(command)
        self.since += 1
        frame = self.inner.step(self.command_in(command or Command()))
        return None if frame is None else self.frame_out(frame)

    def collisions(self) -> int:
        """The inner one's."""
        return self.inner.collisions()

    def close(self) -> None:
        """Close the inner one."""
        self.inner.close()

    def command_in(self, command: Command) -> Command:
        """What the robot carries out instead of a command."""
        return command

    def frame_out(self, frame: Frame) -> Frame:
        """What the robot gets instead of a frame."""
        return frame
