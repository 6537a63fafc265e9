"""Writes the box room's frames in every layout that `rgbd` reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from box_room import cast
from PIL import Image

from dssmsg.frame import Camera

TURNED = np.array(  # a world that is nowhere near z up: files_from_world
    [[0.36, 0.48, -0.8, 0.4], [-0.8, 0.6, 0.0, -1.1], [0.48, 0.64, 0.6, 0.7], [0.0, 0.0, 0.0, 1.0]]
)
Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
SMALL = Camera(160, 120, 130.0, 130.0, 79.5, 59.5)


def save_depth(path: Path, depth, scale):
    Image.fromarray(np.rint(depth * scale).astype(np.uint16)).save(path)


def save_matrix(path: Path, matrix):
    path.write_text("\n".join(" ".join(f"{v:.9g}" for v in row) for row in matrix))


def quaternion(rotation):
    """(x, y, z, w) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation).as_quat()


def sevenscenes(folder: Path, poses, camera=SMALL):
    for number, pose in enumerate(poses):
        rgb, depth = cast(camera, pose)
        stem = folder / f"frame-{16 * number:06d}"
        Image.fromarray(rgb).save(f"{stem}.color.png")
        save_depth(Path(f"{stem}.depth.png"), depth, 1000)
        save_matrix(Path(f"{stem}.pose.txt"), TURNED @ pose)
    save_matrix(folder / "camera-intrinsics.txt", camera.matrix)


def tum(folder: Path, poses, camera=SMALL):
    (folder / "rgb").mkdir()
    (folder / "depth").mkdir()
    lists = {"rgb": ["# colour"], "depth": ["# depth"], "truth": ["# time tx ty tz qx qy qz qw"]}
    for number, pose in enumerate(poses):
        rgb, depth = cast(camera, pose)
        at, also = 100.0 + number / 30, 100.0 + number / 30 + 0.006
        Image.fromarray(rgb).save(folder / f"rgb/{at:.6f}.png")
        save_depth(folder / f"depth/{also:.6f}.png", depth, 5000)
        lists["rgb"].append(f"{at:.6f} rgb/{at:.6f}.png")
        lists["depth"].append(f"{also:.6f} depth/{also:.6f}.png")
        numbers = [at - 0.003, *pose[:3, 3], *quaternion(pose[:3, :3])]
        lists["truth"].append(" ".join(f"{v:.9f}" for v in numbers))
        far = [at + 0.012, 9, 9, 9, 0, 0, 0, 1]  # another sample of the faster clock, not the nearest
        lists["truth"].append(" ".join(f"{v:.9f}" for v in far))
    for name, lines in (("rgb.txt", "rgb"), ("depth.txt", "depth"), ("groundtruth.txt", "truth")):
        (folder / name).write_text("\n".join(lists[lines]) + "\n")


def replica(folder: Path, poses, camera=SMALL):
    (folder / "results").mkdir()
    lines = []
    for number, pose in enumerate(poses):
        rgb, depth = cast(camera, pose)
        Image.fromarray(rgb).save(folder / f"results/frame{number:06d}.jpg", quality=95)
        save_depth(folder / f"results/depth{number:06d}.png", depth, 6553.5)
        lines.append(" ".join(f"{v:.9g}" for v in pose.ravel()))
    (folder / "traj.txt").write_text("\n".join(lines) + "\n")
    values = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": values}))


def scannet(folder: Path, poses, camera=SMALL):
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir()
    own = Camera(128, 96, 110.0, 111.0, 64.0, 47.0)  # the depth camera is another one
    for number, pose in enumerate(poses):
        Image.fromarray(cast(camera, pose)[0]).save(folder / f"color/{number}.jpg")
        save_depth(folder / f"depth/{number}.png", cast(own, pose)[1], 1000)
        save_matrix(folder / f"pose/{number}.txt", pose)
    for name, k in (("color", camera.matrix), ("depth", own.matrix)):
        full = np.eye(4)
        full[:3, :3] = k
        save_matrix(folder / f"intrinsic/intrinsic_{name}.txt", full)


def record3d(folder: Path, poses, camera=SMALL):
    (folder / "rgbd").mkdir()
    small = Camera(80, 60, camera.fx / 2, camera.fy / 2, 39.5, 29.5)
    rows = []
    for number, pose in enumerate(poses):
        Image.fromarray(cast(camera, pose)[0]).save(folder / f"rgbd/{number}.jpg")
        cast(small, pose)[1].astype("<f4").tofile(folder / f"rgbd/{number}.depth")
        turned = Y_UP @ pose @ OPENGL
        rows.append([*quaternion(turned[:3, :3]), *turned[:3, 3]])
    metadata = {
        "K": camera.matrix.T.ravel().tolist(),
        "w": camera.width,
        "h": camera.height,
        "dw": 80,
        "dh": 60,
        "fps": 60,
        "poses": rows,
        "frameTimestamps": [0.1 * number for number in range(len(poses))],
    }
    (folder / "metadata").write_text(json.dumps(metadata))


def redwood(folder: Path, poses, camera=SMALL):
    (folder / "color").mkdir()
    (folder / "depth").mkdir()
    entries = []
    for number, pose in enumerate(poses):
        rgb, depth = cast(camera, pose)
        Image.fromarray(rgb).save(folder / f"color/{number + 1:06d}.jpg")
        save_depth(folder / f"depth/{number + 1:06d}.png", depth, 1000)
        rows = "\n".join(" ".join(f"{v:.10f}" for v in row) for row in TURNED @ pose)
        entries.append(f"{number} {number} {number + 1}\n{rows}\n")
    (folder / "trajectory.log").write_text("".join(entries))
    k = camera.matrix.T.ravel().tolist()
    (folder / "camera.json").write_text(json.dumps({"width": 160, "height": 120, "intrinsic_matrix": k}))


WRITERS = {f.__name__: f for f in (sevenscenes, tum, replica, scannet, record3d, redwood)}
