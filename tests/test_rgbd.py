"""Source `rgbd`: every layout from one known room."""

from __future__ import annotations

import math

import numpy as np
import pytest
from box_room import cast, distance_to_surface, look
from PIL import Image
from rgbd_rooms import KNOWN, POSES, frames, make, source, truth_from_source
from sequence_folders import SMALL, TURNED, WRITERS, save_depth

from dssmsg.frame import Camera
from dssmsg.geometry import back_project_world
from dssmsg.sequences.detect import LAYOUTS, read_folder
from dssmsg.sequences.poses import rigid_or_none
from dssmsg.sequences.resample import resample_depth, scaled_camera


@pytest.mark.parametrize("layout", sorted(WRITERS))
def test_every_layout_gives_the_known_room(tmp_path, layout):
    made = source(str(make(tmp_path, layout)), **(KNOWN if layout == "tum" else {}))
    assert made.info.facts["layouts"] == [layout]
    assert (made.info.visits, made.info.drivable, made.info.has_truth) == (1, False, False)
    found = frames(made)
    assert [f.index for f in found] == list(range(len(POSES)))
    known_from_source = truth_from_source(found, POSES)
    assert known_from_source[:3, 2] == pytest.approx([0, 0, 1], abs=0.01)  # z up
    assert known_from_source[2, 3] == pytest.approx(0.0, abs=0.015)  # the floor at 0
    errors = []
    for frame, pose in zip(found, POSES, strict=True):
        assert known_from_source @ frame.world_from_camera == pytest.approx(pose, abs=0.01)
        points = back_project_world(frame.depth, frame.camera, known_from_source @ frame.world_from_camera)
        assert len(points) > 0.85 * frame.depth.size  # ScanNet's depth camera sees less
        errors.append(distance_to_surface(points))
        assert frame.at_stop
    errors = np.concatenate(errors)
    assert np.median(errors) < 0.005
    assert (
        np.percentile(errors, 97) < 0.03
    )  # the rest are rays beside an edge, where depth is the nearest pixel's


@pytest.mark.parametrize("layout", sorted(WRITERS))
def test_layouts_do_not_mistake_each_other(tmp_path, layout):
    folder = make(tmp_path, layout, POSES[:2])
    assert [name for name, known in LAYOUTS.items() if known.matches(folder)] == [layout]


def test_base_stands_below_the_camera_with_its_heading(tmp_path):
    for frame in frames(source(str(make(tmp_path, "sevenscenes")))):
        base = frame.world_from_base
        assert base[:2, 3] == pytest.approx(frame.position[:2])
        assert base[2, 3] == 0.0
        assert math.atan2(base[1, 0], base[0, 0]) == pytest.approx(frame.heading_rad)
        assert 1.3 < frame.position[2] < 1.6


def test_depth_is_whole_millimetres_and_invalid_values_are_zero(tmp_path):
    folder = make(tmp_path, "sevenscenes")
    path = folder / "frame-000000.depth.png"
    values = np.asarray(Image.open(path)).copy()
    values[0, 0], values[0, 1], values[0, 2] = 0, 65535, 1234
    Image.fromarray(values).save(path)
    frame = frames(source(str(folder)))[0]
    assert frame.depth[0, :3] == pytest.approx([0.0, 0.0, 1.234])


def test_float_depth_with_nan_and_infinity(tmp_path):
    folder = make(tmp_path, "record3d")
    raw = np.fromfile(folder / "rgbd/0.depth", "<f4").reshape(60, 80)
    raw[:10], raw[10:20], raw[20:25] = np.nan, np.inf, -1.0
    raw.tofile(folder / "rgbd/0.depth")
    depth = frames(source(str(folder)))[0].depth
    assert not depth[:48].any()
    assert depth[52:].all()


def test_several_folders_are_several_visits(tmp_path):
    first, second = make(tmp_path, "sevenscenes", POSES[:6], "a"), make(tmp_path, "redwood", POSES[4:], "b")
    made = source([str(first), str(second)])
    assert made.info.visits == 2
    found = frames(made)
    assert [f.visit for f in found] == [0] * 6 + [1] * 6
    known_from_source = truth_from_source(found, POSES)
    for frame, pose in zip(found, [*POSES[:6], *POSES[4:]], strict=True):
        assert known_from_source @ frame.world_from_camera == pytest.approx(pose, abs=0.01)
    made.start_visit(1)
    again = made.step(None)
    assert (again.index, again.sim_time, again.visit) == (6, found[6].sim_time, 1)


def test_times_come_from_the_files(tmp_path):
    found = frames(source(str(make(tmp_path, "tum")), **KNOWN))
    assert [f.sim_time for f in found] == pytest.approx([i / 30 for i in range(len(POSES))], abs=1e-5)
    found = frames(source(str(make(tmp_path, "record3d", name="r"))))
    assert [f.sim_time for f in found] == pytest.approx([0.1 * i for i in range(len(POSES))])
    found = frames(source(str(make(tmp_path, "sevenscenes", name="s"))))
    assert found[1].sim_time == pytest.approx(16 / 30)  # every 16th frame of a 30 Hz recording
    found = frames(source(str(tmp_path / "s"), rate_hz=4.0))
    assert found[1].sim_time == pytest.approx(0.25)


def test_stride_and_max_frames(tmp_path):
    folder = make(tmp_path, "replica")
    found = frames(source(str(folder), stride=3, max_frames=2, up="z", floor=0.0))
    assert len(found) == 2
    assert found[1].world_from_camera == pytest.approx(POSES[3], abs=1e-6)
    assert found[1].sim_time == pytest.approx(3 / 30)


@pytest.mark.parametrize("size", [(80, 60), (100, 45), (320, 240)])
def test_resizing_keeps_the_geometry(tmp_path, size):
    made = source(str(make(tmp_path, "replica", POSES[:3])), size=size, up="z", floor=0.0)
    for frame in frames(made):
        assert (frame.camera.width, frame.camera.height) == size
        points = back_project_world(frame.depth, frame.camera, frame.world_from_camera)
        errors = distance_to_surface(points)
        assert np.median(errors) < 0.012
        seen, _depth = cast(frame.camera, frame.world_from_camera)
        assert np.mean(np.abs(seen.astype(int) - frame.rgb).max(axis=-1) < 30) > 0.93


def test_wide_images_are_made_640_wide(tmp_path):
    camera = Camera(1296, 968, 1170.0, 1170.0, 647.5, 483.5)
    folder = make(tmp_path, "replica", POSES[:1], camera=camera)
    assert source(str(folder)).info.camera == scaled_camera(
        1296, 968, (1170.0, 1170.0, 647.5, 483.5), (640, 478)
    )
    assert source(str(folder), size="keep").info.camera.width == 1296


def test_scaled_intrinsics_see_the_same_rays():
    camera = scaled_camera(640, 480, (500.0, 510.0, 321.0, 237.0), (320, 240))
    for u, v in [(0, 0), (-0.5, -0.5), (319.5, 239.5)]:  # image corners are at half pixels
        big_u, big_v = (u + 0.5) * 2 - 0.5, (v + 0.5) * 2 - 0.5
        assert (u - camera.cx) / camera.fx == pytest.approx((big_u - 321.0) / 500.0)
        assert (v - camera.cy) / camera.fy == pytest.approx((big_v - 237.0) / 510.0)


def test_depth_outside_the_depth_camera_is_no_reading():
    narrow = Camera(40, 30, 60.0, 60.0, 19.5, 14.5)
    wide = Camera(40, 30, 20.0, 20.0, 19.5, 14.5)
    seen = resample_depth(np.full((30, 40), 2.0), narrow, wide)
    assert seen[15, 20] == 2.0
    assert seen[0, 0] == seen[15, 0] == 0.0


@pytest.mark.parametrize("up", ["x", "-x", "y", "-y", "-z"])
def test_given_axis_is_turned_to_z(tmp_path, up):
    from dssmsg.sequences.upright import AXES, rotation_to_z

    turn = np.eye(4)
    turn[:3, :3] = rotation_to_z(np.array(AXES[up])).T
    folder = make(tmp_path, "replica", [turn @ p for p in POSES[:2]])
    for number in range(2):
        depth = cast(SMALL, POSES[number])[1]
        save_depth(folder / f"results/depth{number:06d}.png", depth, 6553.5)
    for frame, pose in zip(frames(source(str(folder), up=up, floor=0.0)), POSES, strict=False):
        assert frame.world_from_camera == pytest.approx(pose, abs=1e-6)


def test_images_overrule_an_axis_that_the_layout_promises(tmp_path, caplog):
    folder = make(tmp_path, "replica")
    lines = [" ".join(f"{v:.9g}" for v in (TURNED @ pose).ravel()) for pose in POSES]
    (folder / "traj.txt").write_text("\n".join(lines))
    made = source(str(folder))
    assert "source.up overrides" in caplog.text
    assert made.info.facts["up_from"] == "estimated"
    found = frames(made)
    assert (truth_from_source(found, POSES))[:3, 2] == pytest.approx([0, 0, 1], abs=0.01)


def test_gravity_from_a_camera_that_only_looks_down_one_way(tmp_path):
    poses = [look(-0.8 + 0.1 * i, -0.9, 1.5, 50, -50) for i in range(4)]
    made = source(str(make(tmp_path, "sevenscenes", poses)))
    assert made.info.facts["up"] == pytest.approx(TURNED[:3, 2], abs=0.02)


@pytest.mark.parametrize(
    ("options", "convert"),
    [
        ({"pose": "camera_from_world"}, lambda pose: np.linalg.inv(pose)),
        ({"camera_axes": "opengl"}, lambda pose: pose @ np.diag([1.0, -1.0, -1.0, 1.0])),
    ],
)
def test_pose_conventions_can_be_overridden(tmp_path, options, convert):
    folder = make(tmp_path, "replica", POSES[:3])
    lines = [" ".join(f"{v:.12g}" for v in convert(pose).ravel()) for pose in POSES[:3]]
    (folder / "traj.txt").write_text("\n".join(lines))
    for frame, pose in zip(frames(source(str(folder), up="z", floor=0.0, **options)), POSES, strict=False):
        assert frame.world_from_camera == pytest.approx(pose, abs=1e-6)


def test_depth_scale_and_intrinsics_can_be_overridden(tmp_path):
    folder = make(tmp_path, "sevenscenes", POSES[:2])
    plain = frames(source(str(folder)))[0]
    made = frames(source(str(folder), depth_scale=2000.0, intrinsics=(100.0, 101.0, 80.0, 60.0)))[0]
    assert made.depth.max() == pytest.approx(plain.depth.max() / 2, abs=0.002)
    assert (made.camera.fx, made.camera.fy, made.camera.cx, made.camera.cy) == (100.0, 101.0, 80.0, 60.0)


def test_invalid_poses_are_left_out_and_counted(tmp_path, caplog):
    folder = make(tmp_path, "scannet")
    (folder / "pose/1.txt").write_text("\n".join(["-inf -inf -inf -inf"] * 4))
    (folder / "pose/2.txt").write_text("nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1")
    (folder / "pose/3.txt").write_text("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1")  # scaled: not rigid
    (folder / "pose/4.txt").unlink()
    (folder / "depth/5.png").unlink()
    made = source(str(folder))
    assert (made.info.facts["invalid_poses"], made.info.facts["without_depth"]) == ([4], [1])
    assert made.info.facts["frames"] == [5]
    assert "4 frames with an invalid pose and 1 without depth, of 10" in caplog.text
    assert [f.index for f in frames(made)] == list(range(5))


def test_rigid_poses_only():
    pose = look(1, 2, 3, 40, -10)
    assert rigid_or_none(pose) == pytest.approx(pose)
    mirrored = pose @ np.diag([1.0, 1.0, -1.0, 1.0])
    sheared = pose.copy()
    sheared[0, 1] += 0.1
    bottom = pose.copy()
    bottom[3, 0] = 1.0
    for bad in (mirrored, sheared, bottom, np.full((4, 4), np.nan)):
        assert rigid_or_none(bad) is None


def test_tum_leaves_out_what_has_no_partner_in_time(tmp_path):
    folder = make(tmp_path, "tum")
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join(lines[:3] + lines[4:]))  # the third depth image is lost
    made = source(str(folder), **KNOWN)
    assert made.info.facts["without_depth"] == [1]
    found = frames(made)
    assert [round(30 * f.sim_time) for f in found] == [0, 1, 3, 4, 5, 6, 7, 8, 9]


def test_same_folder_same_frames(tmp_path):
    folder = str(make(tmp_path, "sevenscenes", POSES[:4]))
    for one, two in zip(frames(source(folder)), frames(source(folder)), strict=True):
        assert np.array_equal(one.world_from_camera, two.world_from_camera)
        assert np.array_equal(one.depth, two.depth)


def test_relative_paths_start_at_the_configuration(tmp_path):
    make(tmp_path, "replica", POSES[:1], "here")
    assert source("here", base=tmp_path).info.scene == "here"


def test_reading_a_folder_tells_where_everything_lies(tmp_path):
    folder = make(tmp_path, "tum", POSES[:2])
    sequence = read_folder(folder)
    assert (sequence.layout, sequence.depth_scale, sequence.up) == ("tum", 5000.0, "z")
    assert [view.depth.parent.name for view in sequence.views] == ["depth", "depth"]
