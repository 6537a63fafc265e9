"""Converted meshes on disk: one npz a mesh in the user's cache folder, never half written."""

from __future__ import annotations

import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any

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
            path = self.folder / f"{key}.npz"
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                count = int(data["texture_count"])
                links = data["face_texture"]
                uv = np.zeros((len(links), 3, 2), np.float32) if count else None
                if uv is not None:
                    uv[links >= 0] = data["uv"]
                textures = tuple(data[f"texture_{i}"] for i in range(count))
                return Mesh(data["vertices"], data["faces"], data["face_colors"], uv, links, textures)
        except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile):
            return None

    def store(self, key: str, mesh: Mesh) -> None:
        """Keep `mesh` under `key`: written to a file beside it first, so that readers see all or nothing."""
        uv = np.empty((0, 3, 2), np.float32) if mesh.uv is None else mesh.uv[mesh.face_texture >= 0]
        arrays: dict[str, Any] = {
            "vertices": mesh.vertices, "faces": mesh.faces, "face_colors": mesh.face_colors, "uv": uv,
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
