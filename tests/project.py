"""A folder with files in it, and the command line run inside it: `project(tmp_path, files).run("config")`."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

FAKES = Path(__file__).parent / "fake_plugins.py"

FAKE_RUN = f"""
name: fake
plugins: [{FAKES}]
source: {{use: fake}}
perception: {{use: fake}}
encoder: {{use: fake}}
llm: {{use: fake}}
association: {{use: fake}}
update: {{use: fake}}
grounding: {{use: fake}}
navigation: {{use: fake}}
mission: {{phases: [survey]}}
recording: {{observers: {{rerun: false, fake: {{}}}}}}
"""
"""A mission of small fakes: a few tiny frames, no simulator, no model, no recording but a text file."""


@dataclass(frozen=True)
class Outcome:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """stdout as JSON: it must hold one value and nothing else."""
        return json.loads(self.out)


@dataclass(frozen=True)
class Project:
    """A folder of a user's."""

    path: Path

    def run(self, *arguments: str, env: Mapping[str, str] | None = None) -> Outcome:
        """Run `dssmsg ARGUMENTS` in this process, inside the folder; `env` adds variables."""
        from dssmsg.cli import main

        out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
        with self.inside(env), redirect_stdout(out), redirect_stderr(err):
            code = main(list(arguments))
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read())
        return Outcome(code, *texts)

    def run_process(self, *arguments: str, env: Mapping[str, str] | None = None) -> Outcome:
        """Run `dssmsg ARGUMENTS` in a process of its own."""
        done = subprocess.run(
            self.command(*arguments),
            cwd=self.path,
            env=environment(env),
            capture_output=True,
            text=True,
            timeout=200,  # the first start of a fresh environment on a busy machine is slow
        )
        return Outcome(done.returncode, done.stdout, done.stderr)

    @staticmethod
    def command(*arguments: str) -> list[str]:
        """The command line as a list for subprocess."""
        return [sys.executable, "-c", "import sys; from dssmsg.cli import main; sys.exit(main())", *arguments]

    @contextmanager
    def inside(self, env: Mapping[str, str] | None = None) -> Iterator[None]:
        """The folder as working directory and an environment without anything of ours but `env`."""
        with chdir(self.path), mock.patch.dict(os.environ, environment(env), clear=True):
            yield

    def snapshot(self) -> dict[str, bytes]:
        """Every file below the folder with its content, Python's caches left out."""
        return {
            str(path.relative_to(self.path)): path.read_bytes()
            for path in sorted(self.path.rglob("*"))
            if path.is_file() and "__pycache__" not in path.parts
        }


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """This process's environment without DSSMSG variables, with `extra`."""
    return {name: value for name, value in os.environ.items() if not name.startswith("DSSMSG")} | dict(
        extra or {}
    )


def project(path: Path, files: Mapping[str, str | bytes] | None = None) -> Project:
    """Write `files` (path -> content) below `path`."""
    for name, content in (files or {}).items():
        place = path / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content.encode() if isinstance(content, str) else content)
    return Project(path)
