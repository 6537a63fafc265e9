"""association/dssm: the paper's object association (III-A), ALGORITHM A.2 and A.3.

One step, one method: candidates by spatial index, score every pair, assign one-to-one, turn the
assignment into changes, now and then join what was split, and say which objects are believed. The scores
themselves are in `dssmsg.graph.scoring`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from dssmsg.frame import Frame, Observation
from dssmsg.graph.changes import Cause, Change, ObjectAdded, ObjectChanged, ObjectMerged, ObjectsJoined, Score
from dssmsg.graph.ids import id_order
from dssmsg.graph.nodes import BELIEVED, ObjectNode
from dssmsg.graph.scoring import assign, confidence, neighbour_hits, neighbour_tolerance, semantic_similarity
from dssmsg.hookspecs import PluginConfig, Register, hookimpl

if TYPE_CHECKING:
    from dssmsg.interfaces import Context

PLUGIN = "association/dssm"
