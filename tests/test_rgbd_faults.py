"""Source `rgbd`: what a user can get wrong ends in an error that names the file or the key."""

from __future__ import annotations

import json

import numpy as np
import pytest
from dssmsg_plugins.source.rgbd import Config
from PIL import Image
from pydantic import ValidationError
from rgbd_rooms import KNOWN, POSES, frames, make, source
from sequence_folders import SMALL

from dssmsg.errors import InputError
from dssmsg.frame import Camera


def test_no_such_folder_a_file_and_an_empty_folder(tmp_path):
    (tmp_path / "seq.zip").write_bytes(b"PK")
    (tmp_path / "empty").mkdir()
    for name, words in (("nowhere", "no such folder"), ("seq.zip", "unpack"), ("empty", "is empty")):
        with pytest.raises(InputError, match=words) as caught:
            source(str(tmp_path / name))
        assert caught.value.key == "source.path"
        assert caught.value.file == str(tmp_path / name)


def test_unknown_layout_lists_the_known_ones_and_the_folder_inside(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=r"tum: rgb\.txt.*sevenscenes: frame-"):
        source(str(tmp_path))
    make(tmp_path, "sevenscenes", POSES[:1], "seq-01")
    with pytest.raises(InputError, match="seq-01/: name that folder"):
        source(str(tmp_path))


def test_the_wrong_layout_by_name(tmp_path):
    folder = make(tmp_path, "tum", POSES[:1])
    with pytest.raises(InputError, match=r"not in the replica layout: expected .*traj\.txt"):
        source(str(folder), layout="replica")


def test_without_depth_images(tmp_path):
    folder = make(tmp_path, "replica", POSES[:2])
    for path in (folder / "results").glob("depth*"):
        path.unlink()
    with pytest.raises(InputError, match="no depth images") as caught:
        source(str(folder))
    assert caught.value.file == str(folder)


def test_without_a_finite_pose(tmp_path):
    folder = make(tmp_path, "redwood", POSES[:2])
    (folder / "trajectory.log").write_text("0 0 1\n" + "nan nan nan nan\n" * 4)
    with pytest.raises(InputError, match="no finite, rigid poses"):
        source(str(folder))


def test_without_colour_images(tmp_path):
    folder = make(tmp_path, "scannet", POSES[:1])
    (folder / "color/0.jpg").unlink()
    with pytest.raises(InputError, match="no colour images"):
        source(str(folder))


def test_unreadable_image_is_named(tmp_path):
    folder = make(tmp_path, "sevenscenes", POSES[:3])
    bad = folder / "frame-000016.color.png"
    bad.write_bytes(bad.read_bytes()[:200])
    made = source(str(folder))
    made.step(None)
    with pytest.raises(InputError, match="cannot be read as an image") as caught:
        made.step(None)
    assert caught.value.file == str(bad)


@pytest.mark.parametrize("name", ["frame-000016.color.png", "frame-000016.depth.png"])
def test_an_image_of_another_size_is_named(tmp_path, name):
    folder = make(tmp_path, "sevenscenes", POSES[:2])
    Image.open(folder / name).resize((80, 60), Image.Resampling.NEAREST).save(folder / name)
    with pytest.raises(InputError, match="expected 160x120 pixels, got 80x60") as caught:
        frames(source(str(folder)))
    assert caught.value.file == str(folder / name)


def test_colour_in_place_of_depth(tmp_path):
    folder = make(tmp_path, "sevenscenes", POSES[:1])
    Image.fromarray(np.zeros((120, 160, 3), np.uint8)).save(folder / "frame-000000.depth.png")
    with pytest.raises(InputError, match="expected a 16-bit depth image, got uint8 120x160x3"):
        source(str(folder))


@pytest.mark.parametrize(
    ("layout", "name", "text", "words"),
    [
        ("sevenscenes", "frame-000000.pose.txt", "1 0 0", "expected a 4x4 matrix, got 3 numbers"),
        ("sevenscenes", "frame-000000.pose.txt", "one two", "expected numbers"),
        ("sevenscenes", "camera-intrinsics.txt", "585", "expected a 3x3 matrix"),
        ("replica", "traj.txt", "1 0 0 0\n", "line 1: expected 16 numbers, got 4"),
        ("replica", "cam_params.json", "{}", "expected {camera"),
        ("tum", "groundtruth.txt", "1.0 2.0\n", "lines of 8 numbers"),
        ("tum", "rgb.txt", "# nothing\n", "a time and a file name"),
        ("redwood", "trajectory.log", "0 0 1\n1 0 0 0\n", "three integers and a 4x4 matrix"),
        ("redwood", "camera.json", '{"intrinsic_matrix": [1, 2]}', "9 numbers"),
        ("record3d", "metadata", "{", "expected JSON"),
        ("record3d", "metadata", '{"K": [1], "poses": []}', "expected JSON with K"),
    ],
)
def test_malformed_text_files_are_named(tmp_path, layout, name, text, words):
    folder = make(tmp_path, layout, POSES[:1])
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        source(str(folder))
    assert caught.value.file == str(folder / name)


def test_binary_in_place_of_a_pose(tmp_path):
    folder = make(tmp_path, "sevenscenes", POSES[:1])
    (folder / "frame-000000.pose.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="cannot be read as text"):
        source(str(folder))


def test_packed_depth_needs_its_unpacker(tmp_path):
    folder = make(tmp_path, "record3d", POSES[:1])
    (folder / "rgbd/0.depth").write_bytes(b"bvx2" + bytes(100))
    with pytest.raises(InputError, match=r"pip install pyliblzfse|cannot be unpacked"):
        source(str(folder))
    (folder / "rgbd/0.depth").write_bytes(bytes(100))
    with pytest.raises(InputError, match="expected 80x60 float32 values, got 100 bytes"):
        source(str(folder))


def test_scannet_without_intrinsics_asks_for_them(tmp_path):
    folder = make(tmp_path, "scannet", POSES[:1])
    (folder / "intrinsic/intrinsic_color.txt").unlink()
    with pytest.raises(InputError, match=r"give \[fx, fy, cx, cy\]") as caught:
        source(str(folder))
    assert caught.value.key == "source.intrinsics"
    assert source(str(folder), intrinsics=(130, 130, 79.5, 59.5)).info.camera.fx == 130


@pytest.mark.parametrize("layout", ["tum", "sevenscenes", "replica", "redwood"])
def test_published_intrinsics_are_not_used_for_images_of_another_size(tmp_path, layout):
    folder = make(tmp_path, layout, POSES[:1])
    for name in ("camera-intrinsics.txt", "cam_params.json", "camera.json"):
        (folder / name).unlink(missing_ok=True)
    with pytest.raises(
        InputError, match=r"known intrinsics are for \d+x\d+ pixels, the images have 160x120"
    ) as caught:
        source(str(folder))
    assert caught.value.key == "source.intrinsics"
    assert source(str(folder), **KNOWN).info.camera == SMALL


def test_visits_of_different_size_need_one_size(tmp_path):
    small = make(tmp_path, "replica", POSES[:1], "small", camera=Camera(80, 60, 65.0, 65.0, 39.5, 29.5))
    big = make(tmp_path, "replica", POSES[:1], "big")
    with pytest.raises(InputError, match="frames of 160x120 after frames of 80x60") as caught:
        source([str(small), str(big)])
    assert caught.value.key == "source.size"
    assert source([str(small), str(big)], size=(80, 60)).info.visits == 2


def test_a_clock_that_stands_still(tmp_path):
    folder = make(tmp_path, "record3d", POSES[:3])
    metadata = json.loads((folder / "metadata").read_text())
    metadata["frameTimestamps"] = [1.0, 1.0, 1.0]
    (folder / "metadata").write_text(json.dumps(metadata))
    with pytest.raises(InputError, match="do not increase: give rate_hz"):
        source(str(folder))
    assert len(frames(source(str(folder), rate_hz=10.0))) == 3


@pytest.mark.parametrize("times", [[1.0, float("nan"), 3.0], [float("nan")] * 3, [1.0, 2.0, float("inf")]])
def test_a_clock_that_is_not_finite(tmp_path, times):
    folder = make(tmp_path, "record3d", POSES[:3])
    metadata = json.loads((folder / "metadata").read_text())
    metadata["frameTimestamps"] = times
    (folder / "metadata").write_text(json.dumps(metadata))
    with pytest.raises(InputError, match="not a finite number: give rate_hz") as caught:
        source(str(folder))
    assert caught.value.file == str(folder)


@pytest.mark.parametrize("name", ["rgb.txt", "depth.txt"])
@pytest.mark.parametrize("where", ["../other/{}", "rgb/../../other/{}", "{absolute}/{}"])
def test_names_that_lead_out_of_the_folder_are_refused(tmp_path, name, where):
    folder = make(tmp_path, "tum", POSES[:2])
    time, image = (folder / name).read_text().splitlines()[-1].split()
    bad = where.format(image, absolute=folder)
    (folder / name).write_text(f"{time} {bad}\n")
    with pytest.raises(InputError, match="expected names of files below its folder") as caught:
        source(str(folder), **KNOWN)
    assert caught.value.file == str(folder / name)


@pytest.mark.parametrize(
    "options",
    [
        {"path": ""},
        {"path": []},
        {"path": "x", "layout": "kitti"},
        {"path": "x", "up": "w"},
        {"path": "x", "depth_scale": 0},
        {"path": "x", "intrinsics": [500, 500, 320]},
        {"path": "x", "size": "large"},
        {"path": "x", "size": [0, 10]},
        {"path": "x", "stride": 0},
        {"path": "x", "strid": 2},
    ],
)
def test_wrong_options_are_refused(options):
    with pytest.raises(ValidationError):
        Config(**options)


def test_unknown_visit_is_refused(tmp_path):
    made = source(str(make(tmp_path, "replica", POSES[:1])))
    with pytest.raises(ValueError, match=r"expected 0\.\.0, got 1"):
        made.start_visit(1)
