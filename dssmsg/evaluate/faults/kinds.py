"""The faults by name: the layer that each is in, and how it is put there."""

from __future__ import annotations

from dataclasses import dataclass

from dssmsg.evaluate.faults import (
    association,
    language,
    matching,
    motion,
    perception,
    planner,
    sensors,
    update,
)
from dssmsg.evaluate.faults.host import Aim, Injection, Options, Wrap


@dataclass(frozen=True, slots=True)
class Fault:
    """A known fault. `changes`: it needs a home in which what is asked for has moved since the survey."""

    name: str
    layer: str
    kind: str
    wrap: Wrap | None = None
    options: Options | None = None
    changes: bool = False
    barriers: bool = False

    def injection(self, aim: Aim) -> Injection:
        """The fault, aimed."""
        return Injection(self.kind, aim, self.wrap, self.options)


FAULTS: tuple[Fault, ...] = (
    Fault("missed class", "detector", "perception", perception.MissedClass),
    Fault("split object", "association", "association", association.SplitObject),
    Fault("called gone", "update", "update", update.CalledGone),
    Fault("wrong target graph", "grounding", "llm", language.WrongTarget),
    Fault("wrong match weight", "matching", "grounding", matching.WrongWeights),
    Fault("no way", "planner", "navigation", planner.NoWay),
    Fault("wheel slip", "control", "source", motion.WheelSlip),
    Fault("lost depth", "environment", "source", sensors.LostDepth),
    Fault("wrong label", "detector", "perception", perception.WrongLabel),
    Fault("wrong merge", "association", "association", association.WrongMerge),
    Fault("stale object", "update", "update", update.NeverGone, changes=True),
    Fault("provider down", "grounding", "llm", language.ProviderDown),
    Fault("worst first", "matching", "grounding", matching.WorstFirst),
    Fault("other goal", "planner", "navigation", planner.OtherGoal),
    Fault("spin slip", "control", "source", motion.SpinSlip),
    Fault("pose jump", "environment", "source", sensors.PoseJump),
    Fault("false label", "detector", "perception", perception.false_label),
    Fault("wrong thing", "matching", "grounding", matching.WrongThing),
    Fault("gives up", "planner", "navigation", planner.GivesUp),
    Fault("veering", "control", "source", motion.Veers),
    Fault("blocked way", "environment", "source", options=sensors.closed_doors, barriers=True),
    Fault("pose drift", "environment", "source", sensors.PoseDrift),
)
"""In an order in which any beginning of the list has many layers in it."""
