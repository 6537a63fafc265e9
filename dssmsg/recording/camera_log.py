"""What the robot is and sees, frame by frame: images, poses, trail, detections, truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import rerun as rr

from dssmsg import events
from dssmsg.frame import FloatArray, TruthObject
from dssmsg.recording import palette, rows, schema
from dssmsg.recording.images import MEDIA_TYPES, Encoding, encode_depth, encode_rgb
from dssmsg.recording.sheets import SheetBook, Stamp

_TRAIL_HEIGHT = (0.0, 0.0, 0.03)  # metres: just above the floor, so that it is seen
_DEPTH_RANGE_MM = (0.0, 5000.0)  # what the colours span, the same in every frame
_BASE_RADIUS, _BASE_HEIGHT = 0.178, 0.109  # metres: the LoCoBot's base


class Encoded(Protocol):
    """Where a frame's images are to be had as bytes, by its index; None if there are none."""

    def encoded_images(self, index: int) -> tuple[bytes, bytes] | None:
        """Colours and depth."""
        ...

    def encoded_truth(self, index: int) -> tuple[bytes, tuple[int, int]] | None:
        """Instances and their (H, W)."""
        ...


class CameraLog:
    """Writes frames into a recording's sheets. Keeps the last frame's pose and no more."""

    def __init__(
        self, book: SheetBook, images: Encoding, quality: int, copied: Encoded | None = None
    ) -> None:
        self._copied = copied
        self._book = book
        self._images: Encoding = images
        self._quality = quality
        self._camera: Any = None
        self._last_spot: FloatArray | None = None
        self._overlaid = False
        self._truth_objects: Sequence[TruthObject] | None = None
        self.picture = b""
        """The last frame's colour image as it was encoded."""

    @property
    def robot_spot(self) -> FloatArray | None:
        """Where the robot stood last (3,), a little above the floor; None before the first frame."""
        return self._last_spot

    def log_static(self) -> None:
        """What never changes: units, colours, the robot's shape."""
        log = self._book.log_now
        log(schema.CAMERA, None, palette.camera_annotations())
        log(
            schema.DEPTH,
            None,
            rr.EncodedDepthImage.from_fields(
                media_type="image/png", meter=1000.0, depth_range=_DEPTH_RANGE_MM
            ),
        )
        for path in (schema.RGB, schema.WINDOW_BEFORE, schema.WINDOW_NOW):
            log(path, None, rr.EncodedImage.from_fields(media_type=MEDIA_TYPES[self._images]))
        log(
            schema.TRAIL,
            None,
            rr.LineStrips3D.from_fields(colors=[palette.TRAIL_COLOUR], radii=rr.Radius.ui_points(2.0)),
        )
        log(
            f"{schema.ROBOT}/body",
            None,
            rr.Cylinders3D(
                lengths=[_BASE_HEIGHT],
                radii=[_BASE_RADIUS],
                centers=[(0.0, 0.0, _BASE_HEIGHT / 2)],
                colors=[palette.ROBOT_COLOUR],
                fill_mode=rr.components.FillMode.Solid,
            ),
        )
        log(
            f"{schema.ROBOT}/heading",
            None,
            rr.Arrows3D(
                origins=[(0.0, 0.0, 1.5 * _BASE_HEIGHT)],
                vectors=[(0.4, 0.0, 0.0)],
                colors=[palette.TRAIL_COLOUR],
                radii=[0.025],
            ),
        )

    def frame(self, event: events.FrameCaptured, stamp: Stamp, updates: int) -> None:
        """A frame's rows, images and poses; `updates` is how many changes the graph had seen before."""
        frame, book = event.frame, self._book
        book.add(schema.FRAMES, stamp, rows.frame_row(event, updates))
        if event.command is not None:
            book.add(schema.COMMANDS, stamp, rows.command_row(event.command))
        stored = None if self._copied is None else self._copied.encoded_images(frame.index)
        if stored is None:
            stored = encode_rgb(frame.rgb, self._images, self._quality), encode_depth(frame.depth)
        self.picture, depth = stored
        book.look(schema.RGB, rr.EncodedImage, stamp, blob=self.picture)
        book.look(schema.DEPTH, rr.EncodedDepthImage, stamp, blob=depth)
        self._pose(schema.CAMERA, stamp, frame.world_from_camera)
        self._pose(schema.ROBOT, stamp, frame.world_from_base)
        if frame.camera != self._camera:
            self._camera = frame.camera
            pinhole = rr.Pinhole(
                image_from_camera=frame.camera.matrix,
                resolution=(frame.camera.width, frame.camera.height),
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.5,
                color=palette.ROBOT_COLOUR,
            )
            book.log_now(schema.CAMERA, stamp, pinhole)
        spot = frame.world_from_base[:3, 3] + _TRAIL_HEIGHT
        if self._last_spot is not None and not np.array_equal(spot, self._last_spot):
            step = np.stack([self._last_spot, spot]).astype(np.float32)
            book.look(schema.TRAIL, rr.LineStrips3D, stamp, strips=step)
        self._last_spot = spot
        if self._overlaid and not event.key_frame:
            self._clear_overlay(stamp)

    def truth(self, event: events.TruthSeen, stamp: Stamp) -> None:
        """A frame's truth; the objects only where they changed."""
        objects, before = event.truth.objects, self._truth_objects
        self._truth_objects = objects
        same = objects is before or (before is not None and _described(objects) == _described(before))
        text = None if same else rows.truth_objects_json(objects)
        stored = None if self._copied is None else self._copied.encoded_truth(event.frame)
        self._book.add(schema.TRUTH, stamp, rows.truth_row(event.truth, text, stored))

    def detections(self, event: events.Detected, stamp: Stamp) -> None:
        """A key frame's detections: rows for replay, and masks, boxes and names over the image."""
        row, blobs = rows.detections_row(event)
        self._book.add(schema.DETECTIONS, stamp, row)
        self._book.add_blobs(stamp, blobs)
        if not event.detections:
            self._clear_overlay(stamp)
            return
        classes = [palette.detection_class(index) for index in range(len(event.detections))]
        masks = [detection.mask for detection in event.detections]
        picture = np.zeros(masks[0].shape, dtype=np.uint8)
        for index in sorted(range(len(masks)), key=lambda index: -int(masks[index].sum())):  # small on top
            picture[masks[index]] = classes[index]
        boxes = np.stack([detection.box_xyxy for detection in event.detections])
        labels = [f"{detection.label} {detection.score:.2f}" for detection in event.detections]
        log = self._book.log_now
        log(schema.SEGMENTATION, stamp, rr.SegmentationImage(picture, opacity=0.35, draw_order=1.0))
        log(
            schema.BOXES,
            stamp,
            rr.Boxes2D(
                array=boxes,
                array_format=rr.Box2DFormat.XYXY,
                labels=labels,
                show_labels=False,
                class_ids=classes,
                draw_order=2.0,
            ),
        )
        # A box that reaches the lower edge would have its own label outside the image.
        centres = (boxes[:, :2] + boxes[:, 2:]) / 2
        log(
            schema.NAMES,
            stamp,
            rr.Points2D(
                centres,
                labels=[detection.label for detection in event.detections],
                show_labels=True,
                class_ids=classes,
                radii=rr.Radius.ui_points(2.0),
                draw_order=3.0,
            ),
        )
        self._overlaid = True

    def _clear_overlay(self, stamp: Stamp) -> None:
        if not self._overlaid:
            return
        for path in (schema.SEGMENTATION, schema.BOXES, schema.NAMES):
            self._book.log_now(path, stamp, rr.Clear(recursive=False))
        self._overlaid = False

    def _pose(self, path: str, stamp: Stamp, world_from_local: FloatArray) -> None:
        self._book.look(
            path,
            rr.Transform3D,
            stamp,
            translation=world_from_local[:3, 3],
            mat3x3=world_from_local[:3, :3],
        )


def _described(objects: Sequence[TruthObject]) -> list[tuple[Any, ...]]:
    """What of a truth's objects can change, to be compared."""
    return [
        (thing.instance_id, thing.name, thing.state, thing.box_min.tobytes(), thing.box_max.tobytes())
        for thing in objects
    ]
