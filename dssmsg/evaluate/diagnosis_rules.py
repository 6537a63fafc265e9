"""The rules of a configuration, built: what `dssmsg explain` and the evaluation of diagnosis ask."""

from __future__ import annotations

from pathlib import Path

from dssmsg.config import RunConfig, Slot
from dssmsg.contexts import ContextFactory
from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.host import Host
from dssmsg.interfaces import Diagnosis

RULES = ("diagnosis",)
"""The kinds of plug-ins that a host needs for rules alone: `Host.load(..., kinds=RULES)`."""


def build_rules(config: RunConfig, host: Host) -> list[tuple[str, Diagnosis]]:
    """The rules that `diagnosis` names, in its order; all that are registered where it names none.

    They come from the local configuration alone: what a recording says of rules is never looked at.
    Raises ConfigError and PluginError as a run does.
    """
    slots = list(config.diagnosis) or [Slot(use=one.name) for one in host.registrations("diagnosis")]
    contexts = ContextFactory(
        host, config.seed, SceneGraph(), IdAllocator(), config.base_dir, Path(), "diagnosis"
    )
    with config.naming_files():
        host.refuse_clashes()
        built = [
            host.build("diagnosis", slot, contexts, base_dir=config.base_dir, key=f"diagnosis[{place}]")
            for place, slot in enumerate(slots)
        ]
    return [(one.registration.name, one.plugin) for one in built]
