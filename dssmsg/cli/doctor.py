"""`dssmsg doctor`: what of this machine and this configuration works, and what to do about the rest."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from dssmsg.cli.output import note, print_json, stdout_to_stderr
from dssmsg.config import RunConfig, load_config
from dssmsg.contexts import ContextFactory
from dssmsg.errors import DssmsgError
from dssmsg.host import Host
from dssmsg.slot_problems import slot_problems

PACKAGES = (
    "rerun-sdk",
    "pluggy",
    "numpy",
    "scipy",
    "onnxruntime",
    "networkx",
    "pybullet",
    "pyyaml",
    "pydantic",
    "typer",
    "rich",
    "pillow",
    "pyarrow",
    "tokenizers",
)
VIEWER_LIBRARIES = ("vulkan", "GL", "EGL", "xkbcommon-x11", "xcb", "Xcursor", "Xi", "Xrandr")
VIEWER_APT = (
    "mesa-vulkan-drivers libgl1-mesa-dri libegl1 libxkbcommon-x11-0 libxcb1 libxcursor1 libxi6 libxrandr2"
)
PLENTY_BYTES, LITTLE_BYTES = 2_000_000_000, 200_000_000


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at. `warn` costs comfort, `fail` prevents a run."""

    check: str
    status: Literal["ok", "warn", "fail"]
    detail: str


def show_doctor(path: Path | None, *, credits: bool, as_json: bool) -> int:
    """Print the findings (or, with `credits`, the authors of the furniture); 1 if something fails."""
    if credits:
        with stdout_to_stderr():
            lines = _credits(path)
        print_json(list(lines)) if as_json else print("\n".join(lines) or "no furniture with credits in use")
        return 0
    findings: list[Finding] = []
    for finding in _examine(path):
        findings.append(finding)
        if not as_json:
            print(f"{finding.status:<5}{finding.check:<12}{finding.detail}", flush=True)
    if as_json:
        print_json([asdict(one) for one in findings])
    failed = [one.check for one in findings if one.status == "fail"]
    note(f"to be mended: {', '.join(failed)}" if failed else "ready to run")
    return 1 if failed else 0


def _examine(path: Path | None) -> Iterator[Finding]:
    yield _python()
    yield from _packages()
    yield _pybullet()
    yield _renderer()
    yield _furniture()
    yield _viewer()
    try:
        with stdout_to_stderr():
            config = load_config(path)
            with config.naming_files():
                host = Host.load(config.plugins, config.base_dir)
    except DssmsgError as error:
        yield Finding("config", "fail", str(error))
        return
    yield from _plugins(host)
    configured = _configuration(config, host)
    yield configured
    if configured.status != "fail":
        yield from _models(config, host)
    yield from _recordings(Path(config.recording.directory))


def _python() -> Finding:
    version = ".".join(map(str, sys.version_info[:3]))
    fits = sys.version_info[:2] == (3, 11)
    return Finding(
        "python",
        "ok" if fits else "warn",
        f"{version} at {sys.executable}{'' if fits else '; made for 3.11'}",
    )


def _packages() -> Iterator[Finding]:
    found = []
    for name in PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            yield Finding("package", "fail", f"{name} is not installed; pip install {name}")
    yield Finding("packages", "ok", ", ".join(found))


def _pybullet() -> Finding:
    """In a subprocess: a compiled module that does not suit the machine may end the process."""
    try:
        done = subprocess.run(
            [sys.executable, "-c", "import pybullet"], capture_output=True, text=True, timeout=60
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Finding("simulator", "fail", f"pybullet cannot be tried: {error}")
    if done.returncode == 0:
        return Finding("simulator", "ok", "pybullet loads")
    reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    return Finding("simulator", "fail", f"pybullet does not load: {reason}; source rgbd works without it")


def _renderer() -> Finding:
    from dssmsg.sim.camera import probe_open3d

    reason = probe_open3d()
    if not reason:
        return Finding("renderer", "ok", "Open3D ray casting")
    return Finding(
        "renderer",
        "warn",
        f"Open3D does not load ({reason}), TinyRenderer is taken, about ten times slower; on Debian: "
        "apt-get install libgomp1 libgl1 libx11-6 libusb-1.0-0",
    )


def _furniture() -> Finding:
    from dssmsg.sim.furniture import FurnitureLibrary

    try:
        library = FurnitureLibrary.open("auto")
    except DssmsgError as error:
        return Finding("furniture", "fail", str(error))
    return Finding("furniture", "ok" if library.kind == "real" else "warn", library.note)


def _viewer() -> Finding:
    missing = [name for name in VIEWER_LIBRARIES if ctypes.util.find_library(name) is None]
    if sys.platform.startswith("linux") and missing:
        return Finding(
            "viewer",
            "warn",
            f"libraries not found: {', '.join(missing)}; recording works; to look at one here: "
            f"apt-get install {VIEWER_APT}, or dssmsg view --web",
        )
    return Finding("viewer", "ok", "its libraries are there")


def _plugins(host: Host) -> Iterator[Finding]:
    names = [one.id for one in host.registrations()]
    yield Finding(
        "plug-ins", "ok" if names else "fail", ", ".join(names) or "none; pip install -e . (or make run)"
    )
    for loaded in host.paths:
        yield Finding("loaded", "ok", loaded)
    for problem in host.problems:
        name = f"{problem.kind}/{problem.name}: " if problem.name else ""
        yield Finding("plug-in", "warn", f"{name}{problem.origin}: {problem.message}")


def _configuration(config: RunConfig, host: Host) -> Finding:
    try:
        host.check(config)
    except DssmsgError as error:
        return Finding("config", "fail", str(error))
    return Finding("config", "ok", str(config.file or "the packaged default"))


def _models(config: RunConfig, host: Host) -> Iterator[Finding]:
    """The encoder, built and asked, which reads its files and checks their hashes; then all other files."""
    encoder = None
    try:
        with stdout_to_stderr():
            slot, contexts = config.encoder, _contexts(config, host)
            encoder = host.build("encoder", slot, contexts, base_dir=config.base_dir).plugin
            encoder.encode_labels(["chair"])
    except DssmsgError as error:
        yield Finding("models", "fail", str(error))
    except Exception as error:
        yield Finding("models", "fail", f"encoder {config.encoder.use}: {type(error).__name__}: {error}")
    else:
        yield Finding("models", "ok", f"encoder {config.encoder.use}: {encoder.space}")
    with stdout_to_stderr():
        problems = list(slot_problems(host, config, encoder))
    for problem in problems:
        # The encoder has been built above, which says the same.
        if not problem.startswith("encoder."):
            yield Finding("models", "fail", problem)


def _recordings(directory: Path) -> Iterator[Finding]:
    place = directory.absolute()
    standing = next(one for one in (place, *place.parents) if one.exists())
    if not standing.is_dir():
        yield Finding("recordings", "fail", f"{standing} is not a folder; set recording.directory")
        return
    try:
        with tempfile.TemporaryFile(dir=standing):
            pass
    except OSError as error:
        yield Finding(
            "recordings", "fail", f"{standing} cannot be written: {error.strerror}; set recording.directory"
        )
    else:
        made = "" if standing == place else " (made on use)"
        yield Finding("recordings", "ok", f"{place}{made}")
    free = shutil.disk_usage(standing).free
    status: Literal["ok", "warn", "fail"] = (
        "ok" if free > PLENTY_BYTES else "warn" if free > LITTLE_BYTES else "fail"
    )
    yield Finding("disk", status, f"{free / 1e9:.1f} GB free at {standing}; a default run takes up to 0.1 GB")


def _credits(path: Path | None) -> tuple[str, ...]:
    config = load_config(path)
    with config.naming_files():
        host = Host.load(config.plugins, config.base_dir)
        source = host.build("source", config.source, _contexts(config, host), base_dir=config.base_dir).plugin
    try:
        lines: tuple[str, ...] = tuple(source.info.credits)
        return lines
    finally:
        source.close()


def _contexts(config: RunConfig, host: Host) -> ContextFactory:
    from dssmsg.graph.ids import IdAllocator
    from dssmsg.graph.scene_graph import SceneGraph

    directory = Path(config.recording.directory)
    return ContextFactory(
        host, config.seed, SceneGraph(), IdAllocator(), config.base_dir, directory, f"doctor-{os.getpid()}"
    )
