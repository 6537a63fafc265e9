"""The schema of a recording: timelines, entities, and the columns of every table.

A recording holds two kinds of entities. *Looks* are Rerun archetypes for the viewer (boxes, images,
text): float32, rounded, thrown away by nobody who computes. *Tables* hold what replay, folding and
diagnosis read back: float64, exact bytes, canonical JSON. Writer and reader both take the tables from
here, so that a column cannot be spelled in two ways. `docs/recording.md` explains each of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pyarrow as pa

SCHEMA_VERSION = 2
"""Raised whenever what a table holds changes; `dssmsg.recording.migrations` reads the older ones."""

APPLICATION_ID = "dssmsg"
COMPARISON_ID = "dssmsg-comparison"
"""Of a file with two runs side by side, which is for the viewer alone: `dssmsg.recording.comparison`."""

# Timelines. A timeline's type never changes within a file: that would spoil the file's footer.
FRAME = "frame"
SIM_TIME = "sim_time"
UPDATE = "update"
ROW = "row"

TEXT = pa.string()
REAL = pa.float64()
WHOLE = pa.int64()
FLAG = pa.bool_()
BYTES = pa.large_binary()


@dataclass(frozen=True)
class Table:
    """An entity whose rows are read back. Each cell is a list: one value, several, or none.

    `archetype` names the columns in the viewer (`GraphChange:kind`).
    """

    path: str
    archetype: str
    columns: dict[str, Any]

    def component(self, column: str) -> str:
        """The Rerun component identifier of a column."""
        return f"{self.archetype}:{column}"


FRAMES = Table(
    "/frames",
    "Frame",
    {
        "index": WHOLE,
        "sim_time": REAL,
        "visit": WHOLE,
        "at_stop": FLAG,
        "key_frame": FLAG,
        "viewpoint": TEXT,
        "collisions": WHOLE,
        "updates": WHOLE,  # of the graph, before this frame
        "camera": REAL,  # width, height, fx, fy, cx, cy
        "world_from_camera": REAL,  # 16, row by row
        "world_from_base": REAL,
    },
)
COMMANDS = Table("/commands", "Command", {"linear": REAL, "angular": REAL, "pan": REAL, "tilt": REAL})
ADVICE = Table(  # of a replay: the commands that navigation asked for and nobody carried out
    "/advice", "Advice", {"linear": REAL, "angular": REAL, "pan": REAL, "tilt": REAL}
)
DETECTIONS = Table(
    "/detections",
    "Detections",
    {
        "labels": TEXT,
        "scores": REAL,
        "boxes": REAL,  # x0 y0 x1 y1 of each, in a row
        "mask_shape": WHOLE,  # count, height, width
        "masks": BYTES,
        "text_features": TEXT,  # hashes into /blobs, empty where there is none
        "image_features": TEXT,
        "label_scores": TEXT,  # JSON: runners-up of each detection
        "observations": TEXT,  # JSON: what could be lifted
        "voxels": WHOLE,  # of each observation: how many its mask holds
        "kept": BYTES,  # which of these are of the thing: deflated bits, one observation after the other
    },
)
BLOBS = Table("/blobs", "Blob", {"hash": TEXT, "data": BYTES})
TRUTH = Table(
    "/truth", "Truth", {"instances": BYTES, "instances_shape": WHOLE, "objects": TEXT}
)  # objects: JSON, only in rows where they changed
GRAPH_LOG = Table(
    "/graph_log",
    "GraphChange",
    {"kind": TEXT, "subjects": TEXT, "cause": TEXT, "scores": TEXT, "json": TEXT},
)
SNAPSHOTS = Table(
    "/graph_snapshots",
    "GraphSnapshot",
    {
        "updates": WHOLE,  # how many changes are in it
        "frame": WHOLE,  # the last one of these changes
        "graph": BYTES,  # zlib of the graph's JSON
    },
)
PHASES = Table("/phases", "Phase", {"phase": TEXT, "visit": WHOLE, "index": WHOLE})
WINDOWS = Table("/windows", "Window", {"viewpoint": TEXT, "verdicts": TEXT, "json": TEXT})
MATCHES = Table("/match", "Match", {"query": TEXT, "json": TEXT})
CANDIDATES = Table(
    "/match/candidates",
    "Candidate",
    {"query": TEXT, "rank": WHOLE, "viewpoint": TEXT, "score": REAL, "scores": TEXT, "matching": TEXT},
)
LLM_CALLS = Table("/llm", "LlmCall", {"role": TEXT, "ok": FLAG, "json": TEXT})
NAVIGATION = Table("/nav/events", "Navigation", {"state": TEXT, "detail": TEXT, "json": TEXT})
EPISODES = Table("/episodes", "Episode", {"goal": TEXT, "outcome": TEXT, "json": TEXT})
ERRORS = Table("/errors", "Error", {"plugin": TEXT, "message": TEXT, "json": TEXT})
TIMINGS = Table("/timings", "Timing", {"stage": TEXT, "seconds": REAL})
LOGS = Table("/logs", "Log", {"logger": TEXT, "level": TEXT, "message": TEXT})

TABLES = (
    FRAMES,
    COMMANDS,
    ADVICE,
    DETECTIONS,
    BLOBS,
    TRUTH,
    GRAPH_LOG,
    SNAPSHOTS,
    PHASES,
    WINDOWS,
    MATCHES,
    CANDIDATES,
    LLM_CALLS,
    NAVIGATION,
    EPISODES,
    ERRORS,
    TIMINGS,
    LOGS,
)

# Looks: what the viewer shows.
WORLD = "/world"
ROBOT = "/world/robot/base"  # moves; the trail beside it stands in the world
TRAIL = "/world/robot/trail"
CAMERA = "/world/camera"
RGB = "/world/camera/rgb"
DEPTH = "/world/camera/depth"
SEGMENTATION = "/world/camera/seg"
BOXES = "/world/camera/boxes"
NAMES = "/world/camera/names"
OBJECTS = "/world/objects"
LABELS = "/world/labels"
SURFACE = "/world/surface"
WAYPOINTS = "/world/waypoints"
VIEWPOINTS = "/world/viewpoints"
HISTORY = "/world/history"
EDGES = "/world/edges"
SEEN_NOW = "/world/edges/seen_now"
GRAPH = "/graph"
PLOTS = "/plots"
NAV_STATE = "/nav/state"
NAV_PATH = "/world/nav_path"
PHASE_STATE = "/nav/phase"
SCORES = "/scores"
MATRIX = "/matrix"
TARGET = "/target"
MATCHED = "/world/matched"
MATCH_TEXT = "/match_text"  # not below /match: the table there shows what stands below it
FOCUS = "/world/focus"  # added by `dssmsg view --focus`, in no file
FOCUS_TEXT = "/focus"
WINDOW_TEXT = "/window"
WINDOW_BEFORE = "/window/before"
WINDOW_NOW = "/window/now"
LOG = "/log"
LLM_TEXT = "/llm"
MISSION = "/mission"

# Run properties, in two groups: what is known at the start, and what only the end tells.
RUN_PROPERTY = "run"
SUMMARY_PROPERTY = "summary"
