"""What is shipped: every folder listed, every stock plug-in an entry point, a wheel that runs anywhere."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def folders(root: Path, name: str) -> set[str]:
    """Packages below a folder, by their `__init__.py`."""
    found = {init.parent.relative_to(root) for init in root.rglob("__init__.py")}
    return {".".join([name, *folder.parts]) for folder in found}


def test_every_package_is_listed():
    listed = set(PROJECT["tool"]["setuptools"]["packages"])
    assert listed == folders(ROOT / "dssmsg", "dssmsg") | folders(ROOT / "plugins", "dssmsg_plugins")


def test_every_stock_plugin_is_an_entry_point():
    modules = {
        f"{file.parent.name}.{file.stem}": f"dssmsg_plugins.{file.parent.name}.{file.stem}"
        for file in (ROOT / "plugins").glob("*/[!_]*.py")
    }
    assert PROJECT["project"]["entry-points"]["dssmsg"] == modules


def test_the_readme_names_both_commands():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "make run" in readme
    assert "make test" in readme


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--disable-pip-version-check"]
    subprocess.run(
        [*command, "--wheel-dir", str(folder), str(ROOT)], check=True, capture_output=True, text=True
    )
    (built,) = folder.glob("dssmsg-*.whl")
    return built


def test_the_wheel_holds_the_data(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    data = {f"dssmsg/data/{file.relative_to(ROOT / 'dssmsg' / 'data')}" for file in data_files()}
    assert data <= names
    assert "dssmsg_plugins/source/pybullet.py" in names
    assert not any("__pycache__" in name or name.startswith("tests/") for name in names)


def data_files():
    return [
        file
        for file in (ROOT / "dssmsg" / "data").rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    ]


def test_installed_from_the_wheel_it_runs_in_an_empty_folder(wheel, tmp_path):
    site, empty = tmp_path / "site", tmp_path / "empty"
    empty.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    done = subprocess.run(
        [
            *[sys.executable, "-m", "dssmsg", "run", "--json"],
            *["--set", "mission.max_frames=12"],
        ],
        cwd=empty,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["frames"] == 12
    assert summary["changes"]["object_added"] > 0, "the default perception saw nothing"
    assert (empty / summary["recording"]).is_file()
    where = subprocess.run(
        [
            sys.executable,
            "-c",
            "import dssmsg, dssmsg_plugins; print(dssmsg.__file__, dssmsg_plugins.__file__)",
        ],
        cwd=empty,
        env={**os.environ, "PYTHONPATH": str(site)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert where.stdout.count(str(site)) == 2
