"""What `view --focus` adds to a recording in the viewer: a bright box round a node, and a page about it.

It is written to a file of its own that names the same run: the viewer shows the two as one recording.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from dssmsg.graph.view import GraphView
from dssmsg.recording import palette, schema
from dssmsg.recording.looks import place

_MARGIN_M = 0.06


def save_focus(path: Path, run_id: str, graph: GraphView, node: str, page: str) -> None:
    """Write the box of a node of the graph, and `page` (Markdown), as an `.rrd` of the run."""
    stream = rr.RecordingStream(schema.APPLICATION_ID, recording_id=run_id, send_properties=False)
    stream.save(str(path))
    box = focus_look(graph, node)
    if box is not None:
        stream.log(schema.FOCUS, box, static=True)
    stream.log(schema.FOCUS_TEXT, rr.TextDocument(page, media_type="text/markdown"), static=True)
    stream.flush()
    stream.disconnect()


def focus_look(graph: GraphView, node: str) -> rr.Boxes3D | None:
    """A labelled box round an object or former place, a small one at other nodes; None for no such node."""
    found = graph.objects.get(node) or graph.history.get(node)
    if found is not None:
        center, half = (found.box_min + found.box_max) / 2, (found.box_max - found.box_min) / 2
        label = f"{node} {found.label}"
    else:
        spot = place(graph, node)
        if spot is None:
            return None
        center, half, label = spot, np.full(3, 0.1), node
    return rr.Boxes3D(
        centers=[np.asarray(center, np.float32)],
        half_sizes=[np.asarray(half + _MARGIN_M, np.float32)],
        labels=[label],
        show_labels=True,
        colors=palette.FOCUS_COLOUR,
        radii=rr.Radius.ui_points(3.0),
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
