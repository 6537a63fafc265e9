"""Converted meshes on disk: one npz a mesh in the user's cache folder, never half written."""

from __future__ import annotations

import os
import tempfile
import zipfile
from pathlib import Path

import numpy as np

from dssmsg.sim.mesh import Mesh


def cache_folder() -> Path:
    """`dssmsg` below $XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dssmsg"


class MeshCache:
    """Meshes by key. A cache that cannot be written or read only costs time: it never stops a run."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = cache_folder() / "meshes" if folder is None else folder

    def load(self, key: str) -> Mesh | None:
        """The mesh under `key`, or None where there is none that can be read."""
        try:
            with np.load(self.folder / f"{key}.npz", allow_pickle=False) as data:
                count = int(data["texture_count"])
                return Mesh(
                    data["vertices"], data["faces"], data["face_colors"], data["uv"], data["face_texture"],
                    tuple(data[f"texture_{i}"] for i in range(count)),
                )  # fmt: skip
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def store(self, key: str, mesh: Mesh) -> None:
        """Keep `mesh`, which has uv, under `key`: written beside it first, so readers see all or nothing."""
        assert mesh.uv is not None
        arrays = {
            "vertices": mesh.vertices, "faces": mesh.faces, "face_colors": mesh.face_colors, "uv": mesh.uv,
            "face_texture": mesh.face_texture, "texture_count": np.array(len(mesh.textures)),
        }  # fmt: skip
        arrays |= {f"texture_{i}": image for i, image in enumerate(mesh.textures)}
        temporary = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=self.folder, suffix=".part", delete=False) as file:
                temporary = Path(file.name)
                np.savez(file, **arrays)
            temporary.replace(self.folder / f"{key}.npz")
        except OSError:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
