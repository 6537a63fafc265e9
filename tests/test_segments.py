import math
import time

import numpy as np
import pytest
from box_scene import NOISE, Thing, context, look, pose_at
from dssmsg_plugins.perception import segments
from dssmsg_plugins.perception.segments import Segments, SegmentsConfig, concave_creases, surface_normals

from dssmsg.frame import Camera, Frame

FULL = Camera.from_fov(320, 240, math.radians(69.4))
THINGS = [
    Thing("table", (1.5, -1.0, 0.0), (2.1, -0.3, 0.5)),
    Thing("chair", (1.4, 0.1, 0.0), (1.8, 0.5, 0.7)),
    Thing("shelf", (2.4, 0.6, 0.0), (2.8, 1.6, 1.2)),
]


def make(noise=(0.0, 0.0), **config):
    return Segments(SegmentsConfig(**config), context(has_truth=False, noise=noise))


def overlap(frame, detections):
    """Best mask IoU of each thing."""
    ids = frame.truth.instance_ids
    return [
        max(((ids == i) & d.mask).sum() / ((ids == i) | d.mask).sum() for d in detections)
        for i in range(1, len(frame.truth.objects) + 1)
    ]


@pytest.mark.parametrize("noise", [(0.0, 0.0), NOISE])
@pytest.mark.parametrize("tilt", [0.0, -0.4])
def test_free_standing_things_are_found_without_truth(noise, tilt):
    frame = look(THINGS, pose_at(0, 0, 0.1, tilt), camera=FULL, noise=noise)
    detections = make(noise).detect(frame.without_truth())
    assert min(overlap(frame, detections)) > 0.5
    assert np.mean(overlap(frame, detections)) > 0.7
    assert len(detections) <= 8


def test_the_empty_room_has_no_things():
    for heading in (0.0, 0.4, 2.0):
        detections = make(NOISE).detect(look([], pose_at(0.5, 0.2, heading, -0.2), camera=FULL, noise=NOISE))
        assert detections == []


def test_pieces_have_no_name_and_a_compactness():
    for detection in make().detect(look(THINGS, pose_at(0, 0, 0.1), camera=FULL)):
        assert detection.label == "object"
        assert 0 < detection.score <= 1
        v, u = np.nonzero(detection.mask)
        assert detection.box_xyxy.tolist() == [u.min(), v.min(), u.max() + 1, v.max() + 1]
    assert make().feature_space is None
    assert {d.label for d in make(label="thing").detect(look(THINGS, pose_at(0, 0, 0.1)))} == {"thing"}


def test_masks_do_not_overlap_and_are_large_enough():
    detections = make(min_pixels=150).detect(look(THINGS, pose_at(0, 0, 0.1, -0.3), camera=FULL, noise=NOISE))
    assert np.sum([d.mask for d in detections], axis=0).max() <= 1
    assert all(d.mask.sum() >= 150 for d in detections)


def test_a_crease_parts_what_stands_on_a_table():
    things = [
        Thing("table", (1.3, -0.6, 0.0), (2.1, 0.6, 0.4)),
        Thing("box", (1.6, -0.2, 0.4), (1.9, 0.2, 0.7)),
    ]
    frame = look(things, pose_at(0, 0, 0, -0.4), camera=FULL)
    assert min(overlap(frame, make(crease_deg=45).detect(frame))) > 0.5
    assert min(overlap(frame, make(crease_deg=180).detect(frame))) < 0.5


def test_normals_face_the_camera_and_fit_the_surface():
    frame = look([], pose_at(0, 0, 0, -0.6), camera=FULL)
    points = segments._world_points(frame)
    normals = surface_normals(points, frame.depth > 0, frame.position)
    floor = points[..., 2] < 0.01
    assert np.median(normals[floor][:, 2]) > 0.99
    wall = (points[..., 0] > 3.99) & (points[..., 2] > 0.3)
    assert np.median(normals[wall][:, 0]) < -0.99
    crease = concave_creases(points, normals, math.radians(60))
    foot = (points[..., 0] > 3.9) & (points[..., 2] < 0.1)
    assert crease[foot].any()


def test_no_depth_no_pieces():
    frame = look([], pose_at(0, 0, 0))
    blind = Frame(0, 0.0, frame.rgb, np.zeros_like(frame.depth), frame.camera, np.eye(4), np.eye(4))
    assert make().detect(blind) == []


def test_frames_do_not_depend_on_each_other():
    perception, frame = make(NOISE), look(THINGS, pose_at(0, 0, 0.1), camera=FULL, noise=NOISE)
    first = [d.mask.tobytes() for d in perception.detect(frame)]
    perception.detect(look([], pose_at(1, 0, 2)))
    assert [d.mask.tobytes() for d in perception.detect(frame)] == first


def test_a_frame_takes_milliseconds():
    frame = look(THINGS, pose_at(0, 0, 0.1, -0.3), camera=FULL, noise=NOISE)
    perception = make(NOISE)
    times = []
    for _ in range(7):
        start = time.process_time()
        perception.detect(frame)
        times.append(time.process_time() - start)
    assert min(times) < 0.15  # about 25 ms; a bound that a slow, busy machine holds too


def test_it_registers_without_asking_for_truth():
    calls = []
    segments.register_perception(lambda *args, **kwargs: calls.append((args, kwargs)))
    assert calls == [(("segments", Segments), {"config": SegmentsConfig})]
    assert all(field.description for field in SegmentsConfig.model_fields.values())
