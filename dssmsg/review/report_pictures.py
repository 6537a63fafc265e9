"""Pictures of a report: frames and crops of objects as small JPEGs inside the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from dssmsg.errors import InputError
from dssmsg.frame import ByteArray
from dssmsg.graph.changes import Change, ObjectAdded, ObjectMerged
from dssmsg.recording import palette
from dssmsg.recording.reader import Recording
from dssmsg.review.report_markup import Markup, tag, text, void

FRAME_WIDTH, CROP_HEIGHT = 420, 96
_QUALITY = 78
_CROP_MARGIN = 0.12


@dataclass(frozen=True, slots=True)
class Sight:
    """A detection that an object was seen by: frame, its index, its score, and how many points it gave."""

    frame: int
    detection: int
    score: float
    points: int

    @property
    def worth(self) -> tuple[float, int]:
        """Sure ones first; of those that are about as sure, the one that shows most of the object."""
        return round(self.score, 1), self.points


def best_sights(changes: Iterable[Change]) -> dict[str, Sight]:
    """The detection to show of each object, by the id that it was seen as."""
    best: dict[str, Sight] = {}
    for change in changes:
        if not isinstance(change, ObjectAdded | ObjectMerged) or change.detection < 0:
            continue
        sight = Sight(change.frame, change.detection, change.score, len(change.points))
        if change.object_id not in best or sight.worth > best[change.object_id].worth:
            best[change.object_id] = sight
    return best


def crops(recording: Recording, sights: Mapping[str, Sight]) -> dict[str, Markup]:
    """A small picture of each object that has one: each frame is decoded once."""
    by_frame: dict[int, list[str]] = {}
    for name, sight in sights.items():
        by_frame.setdefault(sight.frame, []).append(name)
    found: dict[str, Markup] = {}
    for index, names in sorted(by_frame.items()):
        try:
            rgb = recording.frame(index).rgb
            detections = recording.detections(index) or ()
        except InputError:  # cut off, or damaged: the page does without
            continue
        for name in names:
            number = sights[name].detection
            if number < len(detections):
                picture = _crop(rgb, detections[number].box_xyxy)
                if picture is not None:
                    alt = f"{name} in frame {index}"
                    found[name] = void("img", class_="crop", src=_jpeg(picture), alt=alt, title=alt)
    return found


def frame_picture(recording: Recording, index: int, caption: str) -> Markup | None:
    """A frame, its detections outlined where it is a key frame; None where its image was cut off."""
    try:
        rgb = recording.frame(index).rgb
        detections = recording.detections(index) or ()
    except InputError:
        return None
    image = Image.fromarray(rgb)
    scale = FRAME_WIDTH / image.width
    image = image.resize((FRAME_WIDTH, max(1, round(image.height * scale))), Image.Resampling.LANCZOS)
    pen = ImageDraw.Draw(image)
    for number, detection in enumerate(detections):
        x0, y0, x1, y1 = (float(part) * scale for part in detection.box_xyxy)
        if np.isfinite((x0, y0, x1, y1)).all() and x1 >= x0 and y1 >= y0:
            colour = palette.DETECTION_COLOURS[number % len(palette.DETECTION_COLOURS)]
            pen.rectangle((x0, y0, x1, y1), outline=colour, width=2)
    picture = void("img", src=_jpeg(image), alt=f"frame {index}", loading="lazy")
    return tag("figure", picture, tag("figcaption", text(caption, 300)))


def spread(indices: Sequence[int], count: int) -> list[int]:
    """`count` of the indices, evenly over all of them, the first and the last included."""
    if len(indices) <= count:
        return list(indices)
    return [indices[round(n * (len(indices) - 1) / max(count - 1, 1))] for n in range(count)]


def _crop(rgb: ByteArray, box: Sequence[float] | np.ndarray) -> Image.Image | None:
    height, width = rgb.shape[:2]
    if not np.isfinite(box).all():
        return None
    x0, y0, x1, y1 = (float(part) for part in box)
    margin = _CROP_MARGIN * max(x1 - x0, y1 - y0)
    left, upper = max(0, int(x0 - margin)), max(0, int(y0 - margin))
    right, lower = min(width, int(x1 + margin) + 1), min(height, int(y1 + margin) + 1)
    if right - left < 2 or lower - upper < 2:
        return None
    image = Image.fromarray(rgb[upper:lower, left:right])
    scale = min(CROP_HEIGHT / image.height, 2.0 * CROP_HEIGHT / image.width)
    size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
    return image.resize(size, Image.Resampling.LANCZOS)


def _jpeg(image: Image.Image) -> Markup:
    """The picture as the address of an image that stands in the page itself."""
    out = io.BytesIO()
    image.save(out, "JPEG", quality=_QUALITY, optimize=True)
    return Markup(f"data:image/jpeg;base64,{base64.b64encode(out.getvalue()).decode('ascii')}")
