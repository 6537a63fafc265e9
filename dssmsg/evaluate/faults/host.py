"""A host whose plug-ins of one kind carry a fault; the configuration that is recorded knows nothing of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dssmsg.config import RunConfig, Slot
from dssmsg.host import Built, Host, Registration
from dssmsg.interfaces import Context


@dataclass(frozen=True, slots=True)
class Aim:
    """What a fault is aimed at. `label`: of what the goal asks for; `others`: other labels of the home.

    `onset` is the visit in which faults of sensors and wheels begin; `seed` decides what is left to chance.
    """

    label: str
    others: tuple[str, ...]
    seed: int
    onset: int = 1
    barriers: tuple[Mapping[str, Any], ...] = ()
    """Obstacles (as in `source.obstacles`) that close the doors between the robot and the target."""


Wrap = Callable[[Any, Context, Aim], Any]
"""(the built plug-in, a context of its own, the aim) -> the plug-in with the fault."""
Options = Callable[[Aim], Mapping[str, Any]]
"""The options that a plug-in is built with instead of those that are recorded."""


@dataclass(slots=True)
class Injection:
    """A fault in one kind of plug-in: other options, a wrapper, or both."""

    kind: str
    aim: Aim
    wrap: Wrap | None = None
    options: Options | None = None
    carried: list[str] = field(default_factory=list)
    """Plug-ins that got it: it must not be empty after a run."""


class FaultyHost(Host):
    """As `Host`; `injection` is set before the run is built."""

    injection: Injection | None = None

    @classmethod
    def loaded(cls, config: RunConfig, injection: Injection | None) -> FaultyHost:
        """A host with the plug-ins of a configuration."""
        host = cls.load(config.plugins, config.base_dir)
        assert isinstance(host, cls)
        host.injection = injection
        return host

    def build(
        self,
        kind: str,
        slot: Slot | Mapping[str, Any],
        context: Callable[[Registration], Context],
        *,
        base_dir: Path | None = None,
        key: str | None = None,
    ) -> Built:
        """The plug-in of a slot, with the fault where it is of that kind."""
        own = self.injection
        if own is None or own.kind != kind:
            return super().build(kind, slot, context, base_dir=base_dir, key=key)
        if own.options is not None:
            if not isinstance(slot, Slot):
                slot = Slot.model_validate(slot)
            slot = Slot(use=slot.use, **{**slot.options, **own.options(own.aim)})
        built = super().build(kind, slot, context, base_dir=base_dir, key=key)
        own.carried.append(built.registration.id)
        if own.wrap is None:
            return built
        return replace(built, plugin=own.wrap(built.plugin, context(built.registration), own.aim))
