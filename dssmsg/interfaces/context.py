"""What a factory is given besides its own configuration."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dssmsg.graph.ids import IdAllocator
from dssmsg.graph.view import GraphView

if TYPE_CHECKING:
    from dssmsg.interfaces.encoder import Encoder
    from dssmsg.interfaces.llm import Llm
    from dssmsg.interfaces.source import SourceInfo


@dataclass(frozen=True, slots=True)
class Context:
    """The surroundings of one plug-in.

    `rng` is the plug-in's own generator, seeded from the run's seed, its kind and its name, so that
    no plug-in's draws depend on another's. `base_dir` is the folder of the YAML, for relative paths.
    `build` makes a plug-in of another kind from its slot (`{"use": ..., ...}`), as a chain does for its
    links. `source` and `encoder` and `llm` are None while those kinds themselves are being built.
    """

    seed: int
    rng: np.random.Generator
    graph: GraphView
    ids: IdAllocator
    log: logging.Logger
    base_dir: Path
    run_dir: Path
    """Where recordings of this run land (`recording.directory`)."""
    run_id: str
    build: Callable[..., Any]
    """`build(kind, slot)`: the plug-in of `kind` that the slot names; with `option="fallback"` where the
    option that holds the slot is not called like its kind."""
    source: SourceInfo | None = None
    encoder: Encoder | None = None
    llm: Llm | None = None
    timeout_secs: float = 30.0
    """Seconds after which the run ends when a call of the plug-in has not returned (`timeout_secs`)."""
