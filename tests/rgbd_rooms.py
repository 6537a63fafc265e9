"""What the tests of `rgbd` share: a folder of the box room in a layout, its source, all its frames."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from box_room import walk
from dssmsg_plugins.source.rgbd import Config, RgbdSource
from sequence_folders import SMALL, WRITERS

from dssmsg.checks import check_frame

POSES = walk()
KNOWN = {"intrinsics": (SMALL.fx, SMALL.fy, SMALL.cx, SMALL.cy)}  # TUM folders hold none


def source(path, base=Path("/"), **options):
    context = SimpleNamespace(base_dir=base, log=logging.getLogger("dssmsg.test"))
    return RgbdSource(Config(path=path, **options), context)


def frames(made):
    found = []
    for visit in range(made.info.visits):
        made.start_visit(visit)
        while (frame := made.step(None)) is not None:
            found.append(check_frame(frame, made.info, found[-1] if found else None))
    return found


def make(tmp_path, layout, poses=POSES, name="room", **options):
    folder = tmp_path / name
    folder.mkdir()
    WRITERS[layout](folder, poses, **options)
    return folder


def truth_from_source(found, poses):
    """(4, 4): known world <- source's world, which may differ by a turn about z and a shift on the floor."""
    return poses[0] @ np.linalg.inv(found[0].world_from_camera)
