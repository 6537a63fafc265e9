"""Faults of the control: wheels that slip, a robot that turns too little or veers off."""

from __future__ import annotations

from dataclasses import replace

from dssmsg.evaluate.faults.source import BetweenSource
from dssmsg.interfaces import Command


class WheelSlip(BetweenSource):
    """Driving brings it a small part of the way that was asked for."""

    def command_in(self, command: Command) -> Command:
        """The command with a part of its speed."""
        return replace(command, linear=command.linear * (0.1, 0.0, 0.2)[self.aim.seed % 3])


class SpinSlip(BetweenSource):
    """Turning brings it a small part of the angle that was asked for."""

    def command_in(self, command: Command) -> Command:
        """The command with a part of its turn."""
        return replace(command, angular=command.angular * (0.1, 0.0, 0.2)[self.aim.seed % 3])


class Veers(BetweenSource):
    """While it drives it turns to one side by itself."""

    def command_in(self, command: Command) -> Command:
        """The command with a turn in it."""
        if abs(command.linear) < 0.02:
            return command
        return replace(command, angular=command.angular + (0.7 if self.aim.seed % 2 else -0.7))
