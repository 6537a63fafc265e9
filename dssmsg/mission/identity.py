"""What a run is called, and what it ran on."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from dssmsg import __version__
from dssmsg.config import RunConfig
from dssmsg.errors import ConfigError

VERSIONED = ("rerun-sdk", "pluggy", "numpy", "scipy", "open3d-cpu", "open3d", "onnxruntime", "pybullet")
"""Packages whose versions go into the recording's properties."""


def new_run_id(config: RunConfig) -> str:
    """`<time>-<name>`, with a number where files of that stem are already there.

    Raises ConfigError where the folder of the recordings is something else.
    """
    directory = Path(config.recording.directory)
    if directory.exists() and not directory.is_dir():
        raise ConfigError(f"{directory} is a file; expected a folder", key="recording.directory")
    stem = f"{datetime.now():%Y%m%d-%H%M%S}-{config.name}"
    candidate, number = stem, 1
    while any(directory.glob(f"{candidate}.*")):
        number += 1
        candidate = f"{stem}-{number}"
    return candidate


def installed_versions() -> Mapping[str, str]:
    """Versions of this package, Python and the packages that results depend on."""
    versions = {"dssmsg": __version__, "python": platform.python_version()}
    for package in VERSIONED:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions
