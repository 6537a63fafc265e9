"""The command line: results on stdout alone, exit codes, JSON, interruption, lazy imports."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from importlib import util
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from project import FAKE_RUN, FAKES, Outcome, Project, environment, project

import dssmsg
from dssmsg.config_schema import file_schema
from dssmsg.config_yaml import parse_yaml
from dssmsg.frame import Camera, Frame
from dssmsg.host import Host
from dssmsg.interfaces import Context

ROOT = Path(dssmsg.__file__).parents[1]
COMMANDS = (
    *("init", "run", "config", "plugins", "doctor", "view", "inspect", "export", "query", "models", "eval"),
    *("replay", "diff", "explain", "report", "episodes", "sweep"),
)

HEAVY = {"numpy", "rerun", "pydantic", "yaml", "pluggy", "rich", "scipy", "pyarrow", "dssmsg_plugins"}

NOISY = """
import os
print("hello")
os.write(1, b"from C")
from dssmsg.hookspecs import hookimpl
@hookimpl
def register_llm(register):
    print("again")
"""

BAD = """
from fake_plugins import FakePerception
class Bad(FakePerception):
    def detect(self, frame):
        return frame.nothing
"""

SLOW = """
import time
from fake_plugins import FakePerception
from dssmsg.hookspecs import hookimpl

class Slow(FakePerception):
    def detect(self, frame):
        if frame.index == 1:
            print("waiting", flush=True)
            time.sleep(60)
        return super().detect(frame)

@hookimpl
def register_perception(register):
    register("slow", Slow)
"""


@pytest.fixture
def fake(tmp_path: Path) -> Project:
    """A folder with a mission of fakes as its dssmsg.yaml."""
    return project(tmp_path, {"dssmsg.yaml": FAKE_RUN})


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys\n"
        "from dssmsg.cli import main\n"
        "code = main(['--help'])\n"
        "loaded = {name.partition('.')[0] for name in sys.modules}\n"
        f"print('loaded', sorted(loaded & {HEAVY!r}), code)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment())
    assert done.stdout.splitlines()[-1] == "loaded [] 0"
    assert all(command in done.stdout for command in COMMANDS)


def test_run_prints_the_contract_as_json(fake: Project) -> None:
    done = fake.run("run", "--json", "--seed", "3")
    assert done.code == 0, done.err
    summary = done.json
    assert {
        "recording",
        "seed",
        "frames",
        "objects",
        "waypoints",
        "changes",
        "episodes",
        "errors",
        "seconds",
    } <= set(summary)
    assert (summary["seed"], summary["frames"], summary["errors"]) == (3, 3, 0)
    assert (fake.path / summary["recording"]).read_text().endswith("finished\n")


def test_run_prints_a_summary_for_readers(fake: Project) -> None:
    done = fake.run("run")
    assert done.code == 0, done.err
    assert re.search(r"^recording +recordings/\S+-fake\.txt$", done.out, re.MULTILINE)
    assert re.search(r"^frames +3 ", done.out, re.MULTILINE)


def test_two_runs_never_share_a_file(fake: Project) -> None:
    names = {fake.run("run", "--json").json["recording"] for _ in range(2)}
    assert len(names) == 2


def test_plugins_and_libraries_cannot_write_into_the_result(tmp_path: Path) -> None:
    folder = project(
        tmp_path, {"dssmsg.yaml": FAKE_RUN.replace("plugins: [", "plugins: [noisy.py, "), "noisy.py": NOISY}
    )
    done = folder.run_process("run", "--json")
    assert done.code == 0, done.err
    assert done.json["frames"] == 3
    assert "hello" in done.err
    assert "from C" in done.err


def test_failing_plugin_is_counted_and_strict_makes_it_1(tmp_path: Path) -> None:
    folder = project(tmp_path, {"dssmsg.yaml": FAKE_RUN, "bad.py": BAD})
    swap = ("--set", "perception.use=bad.py:Bad")
    done = folder.run("run", "--json", *swap)
    assert (done.code, done.json["errors"] > 0) == (0, True)
    assert folder.run("run", "--strict", *swap).code == 1
    failed = folder.run("run", "--json", *swap, "--set", "on_error=fail")
    assert failed.code == 1
    assert failed.json["error"]["kind"] == "plugin"
    assert "bad.Bad" in failed.err


def test_goal_that_cannot_be_driven_to_is_an_episode_or_an_error_but_no_crash(fake: Project) -> None:
    done = fake.run("run", "--json", "--goal", "a square")
    assert done.code == 0, done.err
    assert "Traceback" not in done.err


def test_init_writes_once_and_its_files_work(tmp_path: Path) -> None:
    folder = project(tmp_path)
    done = folder.run("init", "new")
    assert done.code == 0
    assert done.out.split() == [str(Path("new") / name) for name in ("dssmsg.yaml", "my_detector.py")]
    before = folder.snapshot()
    again = folder.run("init", "new")
    assert (again.code, folder.snapshot()) == (1, before)
    assert "already there" in again.err
    inside = project(tmp_path / "new")
    rows = inside.run("plugins", "--json").json
    assert [row["origin"] for row in rows if row["name"] == "my_detector"] == [
        str(tmp_path / "new/my_detector.py")
    ]
    assert (
        inside.run("config", "--json", "--set", "perception.use=my_detector").json["perception"]["min_pixels"]
        == 200
    )


def test_init_leaves_nothing_half_done(tmp_path: Path) -> None:
    folder = project(tmp_path, {"my_detector.py": "mine"})
    assert folder.run("init").code == 1
    assert folder.snapshot() == {"my_detector.py": b"mine"}


def test_example_plugin_finds_colourful_spots(fake: Project) -> None:
    """my_detector.py of `init`, by file, by `file.py:Class`, in a run."""
    fake.run("init", "sub")
    listed = f"plugins=[sub/my_detector.py, {ROOT}/tests/fake_plugins.py]"
    for sets in (("perception.use=my_detector", listed), ("perception.use=sub/my_detector.py:MyDetector",)):
        done = fake.run("run", "--json", *(part for one in sets for part in ("--set", one)))
        assert done.code == 0, done.err
        assert (done.json["errors"], done.json["objects"]) == (0, 0)  # the fake's wall is grey
    assert colourful_spots() == [(40, 20, 59, 49)]


def colourful_spots() -> list[tuple[float, ...]]:
    """Boxes that the example plug-in finds in a grey picture with one red and one tiny blue patch."""
    rgb = np.full((120, 160, 3), 120, np.uint8)
    rgb[20:50, 40:60] = (200, 10, 10)
    rgb[100:104, 100:104] = (10, 10, 200)
    frame = Frame(
        0, 0.0, rgb, np.ones((120, 160), np.float32), Camera.from_fov(160, 120, 1.0), np.eye(4), np.eye(4)
    )
    host = Host.load([Path(dssmsg.__file__).parent / "data/templates/my_detector.py"], entry_points=())
    (registration,) = host.registrations()
    plugin = registration.factory(registration.config(), cast(Context, None))
    return [tuple(one.box_xyxy.tolist()) for one in plugin.detect(frame)]


def test_config_prints_a_file_that_loads_to_the_same(fake: Project) -> None:
    first = fake.run("config")
    assert first.code == 0, first.err
    project(fake.path, {"again.yaml": first.out})
    assert fake.run("config", "again.yaml").out == first.out
    assert fake.run("config", "--json").json == parse_yaml(first.out)
    assert fake.run("config", "--set", "source.frames=9", "--json").json["source"]["frames"] == 9
    assert fake.run("config", env={"DSSMSG__SOURCE__FRAMES": "8"}).out.count("frames: 8") == 1


def test_schema_holds_the_plugins_own_options(fake: Project) -> None:
    schema = fake.run("config", "--schema").json
    assert "required" not in schema
    choices = {one.get("title"): one for one in schema["properties"]["source"]["anyOf"]}
    assert choices["source/fake"]["properties"]["frames"]["default"] == 3
    assert choices["source/fake"]["additionalProperties"] is False
    references = set(re.findall(r'"#/\$defs/([^"]+)"', json.dumps(schema)))
    assert references <= set(schema["$defs"])
    assert file_schema(Host.load((), entry_points=()))["properties"]["seed"]["minimum"] == 0


def test_plugins_lists_rows_and_failures(tmp_path: Path) -> None:
    folder = project(tmp_path, {"dssmsg.yaml": "plugins: [bad.py]\n", "bad.py": "raise OSError('gone')"})
    done = folder.run("plugins", "--json")
    assert done.code == 0
    assert all({"kind", "name", "origin", "version", "error"} <= set(row) for row in done.json)
    assert [row["error"] for row in done.json if row["error"]][-1] == "failed to load: OSError: gone"
    text = folder.run("plugins", "--options").out
    assert f"failed: {tmp_path}/bad.py: failed to load: OSError: gone" in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import nothing_of_the_kind", "ModuleNotFoundError: No module named 'nothing_of_the_kind'"),
        ("def f(:", "SyntaxError: invalid syntax (line 1)"),
        ("raise SystemExit(3)", "SystemExit: 3"),
    ],
)
def test_a_plugin_file_that_does_not_load_and_is_not_used_is_a_warning(
    tmp_path: Path, text: str, words: str
) -> None:
    files = FAKE_RUN.replace("plugins: [", "plugins: [broken.py, ").replace(
        "rerun: false, fake: {}", "rerun: {}"
    )
    folder = project(tmp_path, {"dssmsg.yaml": files, "broken.py": text})
    said = [f"warning: {tmp_path}/broken.py: failed to load: {words}"]

    def warnings(done: Outcome) -> list[str]:
        return [line for line in done.err.splitlines() if line.startswith("warning")]

    done = folder.run("run", "--json")
    assert (done.code, warnings(done)) == (0, said)
    recording = done.json["recording"]
    plugins = f"plugins=[broken.py, {FAKES}]"
    for command in (
        ("replay", recording, "--set", plugins),
        ("query", recording, "the sofa"),
        ("report", recording),
    ):
        done = folder.run(*command)
        assert (done.code, warnings(done)) == (0, said), done.err
    assert warnings(folder.run("explain", recording, "--episode", "0")) == said
    used = folder.run("run", "--set", "perception.use=mine")
    assert (used.code, len(used.err.splitlines())) == (1, 1)


def test_doctor_looks_at_everything_and_says_what_fails(fake: Project) -> None:
    done = fake.run("doctor", "--json")
    assert done.code == 0, done.out + done.err
    found = {row["check"]: row for row in done.json}
    assert {
        "python",
        "packages",
        "simulator",
        "renderer",
        "furniture",
        "viewer",
        "plug-ins",
        "config",
        "models",
        "recordings",
        "disk",
    } <= set(found)
    assert found["models"]["detail"] == "encoder fake: fake/4"
    assert str(ROOT / "tests/fake_plugins.py") in [
        row["detail"] for row in done.json if row["check"] == "loaded"
    ]
    assert not (fake.path / "recordings").exists()
    assert fake.run("doctor", "--credits").out == "a wall by nobody\n"


def test_doctor_of_a_wrong_configuration_fails_without_a_traceback(tmp_path: Path) -> None:
    folder = project(tmp_path, {"my.yaml": "sead: 1\n"})
    done = folder.run("doctor", "--config", "my.yaml")
    assert done.code == 1
    assert "fail config      my.yaml: sead: unknown key; did you mean 'seed'?" in done.out


def test_version() -> None:
    done = project(Path.cwd()).run("--version")
    assert (done.code, done.out) == (0, f"dssmsg {dssmsg.__version__}\n")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--foo"), "No such option: --foo; see dssmsg run --help"),
        (("runn",), "No such command 'runn'"),
        (("run", "--seed", "x"), "'--seed'"),
        (("run", "a", "b"), "extra argument"),
        (("config", "--set"), "requires an argument"),
    ],
)
def test_wrong_arguments_end_with_2_and_one_line(
    fake: Project, arguments: tuple[str, ...], words: str
) -> None:
    for extra in ((), ("--json",)):
        done = fake.run(*arguments[:1], *extra, *arguments[1:])
        assert done.code == 2
        assert words in done.err
        assert done.err.count("\n") == 1
        if extra and arguments[0] == "run":
            assert done.json["error"]["kind"] == "config"


def test_debug_shows_the_traceback_of_a_known_error(fake: Project) -> None:
    for arguments in (("--debug", "config", "--set", "seed=x"), ("config", "--set", "seed=x", "--debug")):
        done = fake.run(*arguments)
        assert done.code == 2
        assert "Traceback" in done.err
        assert done.err.splitlines()[-1].startswith("error: --set: seed: expected a whole number")


def test_unknown_errors_keep_their_traceback(fake: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: object, **options: object) -> None:
        raise ZeroDivisionError("inside")

    monkeypatch.setattr("dssmsg.cli.configuration.load_config", broken)
    done = fake.run("config", "--json")
    assert done.code == 1
    assert "Traceback" in done.err
    assert done.json["error"]["kind"] == "internal"


def test_closed_pipe_is_no_traceback(fake: Project) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        fake.command("config"),
        cwd=fake.path,
        env=environment(),
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_interruption_closes_the_recording(
    tmp_path: Path, number: signal.Signals, code: int, word: str
) -> None:
    config = FAKE_RUN.replace("plugins: [", "plugins: [slow.py, ").replace(
        "perception: {use: fake}", "perception: {use: slow}"
    )
    folder = project(tmp_path, {"dssmsg.yaml": config, "slow.py": SLOW})
    running = subprocess.Popen(
        folder.command("run", "--json"),
        cwd=tmp_path,
        env=environment({"PYTHONPATH": f"{ROOT / 'tests'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # Started from a job in the background, this process ignores Ctrl-C, and its children would too.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert running.stderr is not None
    lines = []
    for line in running.stderr:
        lines.append(line)
        if line.startswith("waiting"):
            break
    time.sleep(0.2)
    running.send_signal(number)
    out, err = running.communicate(timeout=30)
    assert running.returncode == code, "".join(lines) + err
    assert err.splitlines()[-1] == word
    assert "Traceback" not in err
    assert json.loads(out)["error"]["kind"] == word
    (kept,) = (tmp_path / "recordings").iterdir()
    assert str(kept.relative_to(tmp_path)) in err


def test_hanging_plugin_ends_the_run_with_1(tmp_path: Path) -> None:
    config = FAKE_RUN.replace("plugins: [", "plugins: [slow.py, ").replace(
        "perception: {use: fake}", "perception: {use: slow}"
    )
    folder = project(tmp_path, {"dssmsg.yaml": config + "timeout_secs: 0.5\n", "slow.py": SLOW})
    done = folder.run_process(
        "run",
        "--json",
        env={"PYTHONPATH": f"{ROOT / 'tests'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"},
    )
    assert done.code == 1
    assert "perception/slow: detect did not return within 0.5 s" in done.err
    assert done.json["error"]["kind"] == "timeout"


def refresh() -> object:
    spec = util.spec_from_file_location("refresh_docs", ROOT / "docs/refresh.py")
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["cli.md", "configuration.md", "plugins.md"])
def test_documents_are_current(name: str) -> None:
    """Help texts, the configuration reference and the example plug-in in docs/ are the program's own."""
    assert refresh().refreshed(name) == (ROOT / "docs" / name).read_text(encoding="utf-8")  # type: ignore[attr-defined]


def test_every_command_is_documented() -> None:
    text = (ROOT / "docs/cli.md").read_text(encoding="utf-8")
    assert all(f"$ dssmsg {command} --help" in text for command in COMMANDS)
