"""The guard and the checks: what becomes of plug-ins that raise, return the wrong thing, or hang."""

from __future__ import annotations

import math
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from fake_plugins import CAMERA, FakeSource, SourceConfig

from dssmsg import checks
from dssmsg.errors import ConfigError, PluginError, StorageError
from dssmsg.events import Candidate, ErrorOccurred
from dssmsg.frame import Camera, Detection, Frame, Observation
from dssmsg.graph.changes import Cause, Change, ObjectAdded, ObjectChanged, Score
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.guard import Guard
from dssmsg.interfaces import Box, Command, SourceInfo, Step, UpdateResult

INFO = SourceInfo(name="fake", camera=CAMERA, drivable=False, has_truth=False)


def frame(**values: Any) -> Frame:
    made = FakeSource(SourceConfig(), None).step(None)  # type: ignore[arg-type]
    assert made is not None
    return replace(made, **values)


def boom() -> None:
    raise ValueError("no such\nthing")


class Told:
    """Collects what a guard reports."""

    def __init__(self) -> None:
        self.events: list[ErrorOccurred] = []

    def __call__(self, event: ErrorOccurred) -> None:
        self.events.append(event)


def test_value_and_arguments_pass_through() -> None:
    with Guard() as guard:
        assert guard.call("llm/a", "add", lambda a, b: a + b, 2, 3, check=lambda value: value * 10) == 50
        assert not guard.errors


def test_skip_reports_counts_and_gives_the_default() -> None:
    told = Told()
    with Guard("skip", report=told) as guard:
        guard.at(7, 1.4)
        assert guard.call("llm/a", "complete", boom, default=()) == ()
    (event,) = told.events
    assert (event.frame, event.sim_time, event.plugin, event.skipped, event.fatal) == (
        7,
        1.4,
        "llm/a",
        "complete",
        False,
    )
    assert event.message.startswith("complete failed: ValueError: no such thing (test_guard.py:")
    assert guard.errors == {"llm/a": 1}


def test_fail_raises_with_the_cause_after_reporting() -> None:
    told = Told()
    with (
        Guard("fail", report=told) as guard,
        pytest.raises(PluginError, match="plug-in llm/a: complete failed") as caught,
    ):
        guard.call("llm/a", "complete", boom, default=())
    assert isinstance(caught.value.__cause__, ValueError)
    assert told.events[0].fatal


def test_without_a_default_nothing_can_be_skipped() -> None:
    with Guard("skip") as guard, pytest.raises(PluginError):
        guard.call("source/a", "step", boom)


@pytest.mark.parametrize("error", [StorageError("full"), ConfigError("x"), KeyboardInterrupt()])
def test_some_errors_are_not_the_frames(error: BaseException) -> None:
    told = Told()

    def fail() -> None:
        raise error

    with Guard("skip", report=told) as guard, pytest.raises(type(error)):
        guard.call("observer/a", "on_event", fail, default=None)
    assert told.events == []


def test_plugin_that_exits_is_a_failing_plugin() -> None:
    with Guard("skip") as guard:
        assert guard.call("llm/a", "complete", sys.exit, 0, default="skipped") == "skipped"


def test_failed_check_is_a_failure() -> None:
    told = Told()
    with Guard("skip", report=told) as guard:
        value = guard.call(
            "perception/a",
            "detect",
            lambda: None,
            check=lambda v: checks.check_detections(frame(), v),
            default=(),
        )
    assert value == ()
    assert told.events[0].message == "detect failed: CheckFailed: expected a list of Detection, got nothing"


@dataclass
class Watched:
    """A guard whose process does not really end, and what it did."""

    guard: Guard
    told: Told
    flushed: list[bool]
    codes: list[int]


def watched(timeout: float) -> Watched:
    told, flushed, codes = Told(), [], []  # type: ignore[var-annotated]
    guard = Guard("skip", timeout, told, on_hang=lambda: flushed.append(True), end_process=codes.append)
    return Watched(guard, told, flushed, codes)


def test_hang_is_reported_flushed_and_ends_the_process(capsys: pytest.CaptureFixture[str]) -> None:
    hang = watched(0.1)
    hang.guard.at(3, 0.6)
    hang.guard.call("perception/slow", "detect", time.sleep, 0.6)
    hang.guard.close()
    (event,) = hang.told.events
    assert (event.plugin, event.frame, event.fatal) == ("perception/slow", 3, True)
    assert (hang.flushed, hang.codes) == ([True], [1])
    line = capsys.readouterr().err
    assert line.startswith("error: plug-in perception/slow: detect did not return within 0.1 s")
    assert line.count("\n") == 1


def test_quick_calls_and_pauses_between_calls_do_not_count() -> None:
    calm = watched(0.6)
    for _ in range(5):
        calm.guard.call("perception/a", "detect", time.sleep, 0.2)
        time.sleep(0.05)
    calm.guard.close()
    assert calm.codes == []


def test_call_inside_a_call_has_its_own_time() -> None:
    nested = watched(0.6)

    def outer() -> None:
        for _ in range(4):
            nested.guard.call("llm/inner", "complete", time.sleep, 0.2)

    nested.guard.call("update/outer", "update", outer)
    nested.guard.close()
    assert nested.codes == []


def test_flush_that_hangs_too_does_not_keep_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dssmsg.guard.FLUSH_SECS", 0.1)
    codes: list[int] = []
    release = threading.Event()
    guard = Guard("skip", 0.05, on_hang=lambda: bool(release.wait(5)), end_process=codes.append)
    guard.call("a/b", "c", time.sleep, 0.5)
    guard.close()
    release.set()
    assert codes == [1]


def test_one_thread_for_many_calls() -> None:
    before = set(threading.enumerate())
    with Guard() as guard:
        for _ in range(500):
            guard.call("a/b", "c", int)
        assert [one.name for one in set(threading.enumerate()) - before] == ["dssmsg-watchdog"]
    assert set(threading.enumerate()) <= before


def test_hanging_process_really_ends_with_1() -> None:
    script = (
        "import sys, time\n"
        "from dssmsg.guard import Guard\n"
        "guard = Guard('skip', 0.2, on_hang=lambda: print('flushed', flush=True))\n"
        "guard.call('perception/slow', 'detect', time.sleep, 60)\n"
    )
    started = time.monotonic()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30)
    assert (done.returncode, done.stdout) == (1, "flushed\n")
    assert "perception/slow" in done.stderr
    assert time.monotonic() - started < 15


# The checks


def detection(**values: Any) -> Detection:
    made = {
        "mask": np.ones((24, 32), bool),
        "box_xyxy": np.array([0.0, 0, 31, 23]),
        "label": "x",
        "score": 0.5,
    }
    return Detection(**(made | values))


def observation(**values: Any) -> Observation:
    made: dict[str, Any] = {
        "detection_index": 0,
        "label": "x",
        "score": 0.5,
        "points_world": np.zeros((5, 3), np.float32),
        "colors": np.zeros((5, 3), np.uint8),
        "box_min": np.zeros(3),
        "box_max": np.ones(3),
        "range_m": 1.0,
    }
    return Observation(**(made | values))


def added(**values: Any) -> ObjectAdded:
    made: dict[str, Any] = {
        "cause": Cause("association/x", "new"),
        "object_id": "object-1",
        "label": "x",
        "score": 0.5,
        "points": np.zeros((5, 3), np.float32),
        "colors": np.zeros((5, 3), np.uint8),
        "viewpoint_id": None,
        "range_m": 1.0,
    }
    return ObjectAdded(**(made | values))


class Made(Change):
    kind = "made_up"


def rotated(scale: float) -> Any:
    pose = np.eye(4)
    pose[:3, :3] *= scale
    return pose


def test_good_values_pass_as_tuples() -> None:
    one = frame()
    assert checks.check_frame(one, INFO) is one
    assert checks.check_frame(None, INFO) is None
    assert checks.check_detections(one, [detection()])[0].label == "x"
    assert isinstance(checks.check_detections(one, []), tuple)
    assert len(checks.check_observations([observation()])) == 1
    assert len(checks.check_changes([added()])) == 1
    assert checks.check_update(UpdateResult()).changes == ()
    assert checks.check_command(Command(1, 0)).linear == 1.0
    assert checks.check_step(Step(Command(), "turn")).state == "turn"
    assert checks.check_vectors(np.eye(3, dtype=np.float32), 3, 3).shape == (3, 3)
    assert checks.check_candidates(SceneGraph(), []) == ()
    assert checks.check_tags(["cup"]) == ("cup",)
    assert len(checks.check_boxes([Box(np.array([0.0, 0, 1, 1]), "x", 1.0)])) == 1
    assert len(checks.check_masks(one, [np.zeros((24, 32), bool)], 1)) == 1


@pytest.mark.parametrize(
    ("check", "value", "words"),
    [
        ("frame", 3, "expected a Frame or None, got int"),
        ("frame", {"camera": "small"}, r"expected images of \(24, 32\) \(rows, columns\), got \(12, 16\)"),
        ("frame", {"world_from_camera": rotated(2.0)}, "world_from_camera is not a rigid transform"),
        ("frame", {"world_from_base": np.diag([1.0, 1, -1, 1])}, "world_from_base is not a rigid"),
        ("frame", {"sim_time": math.nan}, "sim_time is nan"),
        ("frame", {"depth": np.full((24, 32), 1.00049, np.float32)}, "whole millimetres"),
        ("frame", {"depth": np.full((24, 32), -1.0, np.float32)}, "whole millimetres"),
        ("detections", None, "expected a list of Detection, got nothing"),
        ("detections", "text", "got str"),
        ("detections", [3], "detection 0: expected Detection, got int"),
        ("detections", (one for one in ()), "got generator"),
        (
            "detections",
            [detection(mask=np.ones((12, 16), bool))],
            r"detection 0: mask: expected \(24, 32\), got \(12, 16\)",
        ),
        (
            "detections",
            [detection(text_feature=np.float32([1, 0])), detection(text_feature=np.float32([1, 0, 0]))],
            r"detection 1: text_feature: expected \(2,\), got \(3,\)",
        ),
        (
            "observations",
            [observation(points_world=np.zeros((5, 2), np.float32))],
            r"expected \(N, 3\), got \(5, 2\)",
        ),
        ("observations", [observation(points_world=np.full((5, 3), np.nan, np.float32))], "NaN"),
        ("observations", [observation(colors=np.zeros((4, 3), np.uint8))], r"colors: expected \(5, 3\)"),
        ("observations", [observation(box_min=np.full(3, 2.0))], "box_min is above box_max"),
        ("observations", [observation(score=1.5)], "score: expected a number in 0..1"),
        ("changes", [Made(cause=Cause("a", "b"))], "no kind of change"),
        ("changes", [added(points=np.full((5, 3), np.inf, np.float32))], "points holds NaN or infinity"),
        ("changes", [added(range_m=math.nan)], "range_m is nan"),
        ("changes", [added(scores=(Score("s_geo", math.nan),))], "score s_geo is nan"),
        ("changes", added(), "expected a list of Change, got ObjectAdded"),
        ("update", [], "expected an UpdateResult, got list"),
        ("update", UpdateResult(windows=(3,)), "window 0: expected WindowEvaluated"),  # type: ignore[arg-type]
        ("command", Command(math.inf), "linear is inf"),
        ("command", Command("fast"), "linear: expected a number, got str"),  # type: ignore[arg-type]
        ("step", None, "expected a Step, got nothing"),
        ("step", Step(Command(math.nan), "turn"), "linear is nan"),
        ("step", Step(Command(), None), "expected text as state"),  # type: ignore[arg-type]
        ("candidates", [Candidate("viewpoint-1.1", 1, {}, {})], "no viewpoint 'viewpoint-1.1' in the graph"),
        ("vectors", np.ones((2, 3), np.float32), "expected unit vectors, the length of one is 1.7321"),
        ("vectors", np.eye(3, dtype=np.float32), r"expected \(2, 3\), got \(3, 3\)"),
        ("vectors", np.full((2, 3), np.nan, np.float32), "NaN"),
        ("tags", ["cup", " "], "tag 1 is empty"),
        ("boxes", [Box(np.array([5.0, 0, 1, 1]), "x", 1.0)], "x0 <= x1"),
        ("masks", [np.zeros((24, 32), np.uint8)], "expected bool, got uint8"),
        ("masks", [], "expected 1 masks, one a box, got 0"),
        ("findings", ["it was me"], "finding 0: expected Finding, got str"),
        ("answer", {"a": 1}, "expected an Answer, got dict"),
    ],
)
def test_wrong_values_say_what_was_expected_and_got(check: str, value: Any, words: str) -> None:
    if check == "frame" and isinstance(value, dict):
        value = dict(value)
        if value.pop("camera", None):
            size = (12, 16)
            value |= {
                "camera": Camera.from_fov(16, 12, 1.2),
                "rgb": np.zeros((*size, 3), np.uint8),
                "depth": np.zeros(size, np.float32),
            }
        value = frame(**value)
    run = {
        "frame": lambda: checks.check_frame(value, INFO),
        "detections": lambda: checks.check_detections(frame(), value),
        "candidates": lambda: checks.check_candidates(SceneGraph(), value),
        "vectors": lambda: checks.check_vectors(value, 2, 3),
        "masks": lambda: checks.check_masks(frame(), value, 1),
    }.get(check, lambda: getattr(checks, f"check_{check}")(value))
    with pytest.raises(checks.CheckFailed, match=words):
        run()


def test_frames_run_forwards() -> None:
    first, second = frame(index=4, sim_time=1.0), frame(index=5, sim_time=1.2)
    assert checks.check_frame(second, INFO, first) is second
    with pytest.raises(checks.CheckFailed, match="index above 5, got 4"):
        checks.check_frame(first, INFO, second)
    with pytest.raises(checks.CheckFailed, match="goes back"):
        checks.check_frame(frame(index=6, sim_time=1.1), INFO, second)


def test_a_change_of_facts_passes() -> None:
    change = ObjectChanged(cause=Cause("a/b", "c"), object_id="object-1", values={"state": "moved"})
    assert checks.check_changes((change,)) == (change,)
