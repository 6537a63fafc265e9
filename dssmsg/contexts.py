"""What each plug-in is given: its own generator, and the shared read-only surroundings."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.view import GraphView
from dssmsg.host import Host, Registration
from dssmsg.interfaces import Context

if TYPE_CHECKING:
    from dssmsg.config import Slot
    from dssmsg.interfaces import Encoder, Llm, SourceInfo


def plugin_rng(seed: int, kind: str, name: str) -> np.random.Generator:
    """A generator that depends on the run's seed and the plug-in's kind and name, and on nothing else."""
    digest = hashlib.sha256(f"{kind}/{name}".encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    return np.random.default_rng(np.random.SeedSequence([seed, *words]))


@dataclass(slots=True)
class ContextFactory:
    """Makes a plug-in's Context. Set `source`, `encoder` and `llm` as these come to be."""

    host: Host
    seed: int
    graph: GraphView
    ids: IdAllocator
    base_dir: Path
    run_dir: Path
    run_id: str
    source: SourceInfo | None = None
    encoder: Encoder | None = None
    llm: Llm | None = None
    made: dict[str, Registration] = field(default_factory=dict)
    """What was built, links of a chain included, by dotted key."""
    timeout_secs: float = 30.0

    def __call__(self, registration: Registration) -> Context:
        """The context of one plug-in; what it builds itself gets a context of its own."""
        key = registration.kind

        def build(kind: str, slot: Slot | Mapping[str, Any], *, option: str | None = None) -> Any:
            place = f"{key}.{option or kind}"
            built = self.host.build(kind, slot, self, base_dir=self.base_dir, key=place)
            self.made[place] = built.registration
            return built.plugin

        return Context(
            seed=self.seed,
            rng=plugin_rng(self.seed, registration.kind, registration.name),
            graph=self.graph,
            ids=self.ids,
            log=logging.getLogger(f"dssmsg.{registration.kind}.{registration.name}"),
            base_dir=self.base_dir,
            run_dir=self.run_dir,
            run_id=self.run_id,
            build=build,
            source=self.source,
            encoder=self.encoder,
            llm=self.llm,
            timeout_secs=self.timeout_secs,
        )
