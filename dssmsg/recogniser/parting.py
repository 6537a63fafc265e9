"""Groups taken apart where space parts them: votes from afar may land on a centre that is not theirs."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from dssmsg.depth_components import depth_components
from dssmsg.frame import IntArray
from dssmsg.geometry import box_distance
from dssmsg.recogniser.inputs import HalfGeometry


def parted(
    numbers: IntArray, groups: int, geometry: HalfGeometry, *, gap: float, least: int
) -> tuple[IntArray, list[int]]:
    """Numbers (h, w) in which no group has parts farther apart than `gap` metres, and the new ones' origins.

    A part that is too far from the group's largest becomes a group of its own, numbered from `groups` + 1 on,
    where it has `least` pixels, else nothing. The list has the old number of each new one. What touches in
    the image at one depth is one part; the distance is that of the parts' boxes, so that a chair seen through
    the legs of a table stays whole.
    """
    result = numbers.copy()
    origins: list[int] = []
    for number, window in enumerate(ndimage.find_objects(numbers), start=1):
        if window is None:
            continue
        inside = numbers[window] == number
        parts = depth_components(geometry.depth[window], inside)
        sizes = np.bincount(parts[parts >= 0])
        if len(sizes) < 2:
            continue
        points = geometry.points[window]
        boxes = {
            int(part): (points[parts == part].min(axis=0), points[parts == part].max(axis=0))
            for part in np.flatnonzero(sizes >= least // 2)
        }
        order = sorted(boxes, key=lambda part: (-sizes[part], part))
        kept = order[:1]
        for part in order[1:]:
            near = any(float(box_distance(*boxes[part], *boxes[one])) <= gap for one in kept)
            if near:
                kept.append(part)
                continue
            here = result[window]
            if sizes[part] >= least:
                origins.append(number)
                here[parts == part] = groups + len(origins)
            else:
                here[parts == part] = 0
    return result, origins
