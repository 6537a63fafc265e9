"""The stages of `verify.py` about the spine: recording and folding, survival, camera, time, memory."""

from __future__ import annotations

import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from staging import ENVIRONMENT, Row, dssmsg, recording_of, run

HERE = Path(__file__).resolve().parent


def folding(cwd: Path) -> list[Row]:
    """Folding the default run's recording gives the graph that the live run had."""
    from dssmsg.config import load_config
    from dssmsg.graph.compare import first_difference
    from dssmsg.graph.scene_graph import SceneGraph
    from dssmsg.host import Host
    from dssmsg.mission.run import run_mission
    from dssmsg.recording.reader import Recording

    os.chdir(cwd)
    config = load_config(None, sets=["perception.use=oracle"])
    probe = LiveGraphs(random.Random(0))
    result = run_mission(config, Host.load(), observers=[("live", probe)])
    recording = Recording.open(Path(result.summary["recording"]))
    wrong = [
        d for frame, live in probe.kept.items() if (d := first_difference(live, recording.graph_at(frame)))
    ]
    final = first_difference(result.graph, SceneGraph.fold(recording.changes()))
    frames = len(probe.kept)
    return [
        Row("folding the file = live graph, at the end", "equal", final or "equal", not final),
        Row(f"... at {frames} random frames", "equal", wrong[0] if wrong else "equal", not wrong),
    ]


class LiveGraphs:
    """An observer that keeps the graph as it was at some random frames."""

    def __init__(self, rng: random.Random) -> None:
        from dssmsg.graph.scene_graph import SceneGraph

        self._rng = rng
        self._changes: list = []
        self._fold = SceneGraph.fold
        self.kept: dict = {}

    def on_event(self, event: object) -> None:
        """Keep the graph at about every hundredth frame with changes."""
        from dssmsg.events import GraphChanged

        if isinstance(event, GraphChanged):
            self._changes.extend(event.changes)
            if self._rng.random() < 0.03:
                self.kept[event.frame] = self._fold(self._changes)

    def close(self) -> None:
        """Nothing to close."""

    def outputs(self) -> dict[str, str]:
        """Nothing left behind."""
        return {}


def determinism(cwd: Path) -> list[Row]:
    """Two processes, one change log; and one with the truth taken from the frames."""
    rows = []
    for title, sets in (("oracle", ["perception.use=oracle"]), ("the default, which needs no truth", [])):
        logs = [change_log(run(cwd, *sets, "recording.observers.jsonl={}"), cwd) for _ in range(2)]
        same = logs[0] == logs[1]
        rows.append(
            Row(f"two processes, same change log: {title}", "identical", f"{len(logs[0])} bytes", same)
        )
    removed = run(
        cwd,
        "recording.observers.jsonl={}",
        f"plugins=[{HERE / 'truthless.py'}]",
        "source={use: truthless}",
    )
    same = change_log(removed, cwd) == logs[0]
    rows.append(Row("same log with truth removed from the frames", "identical", "compared", same))
    return rows


def change_log(summary: dict, cwd: Path) -> bytes:
    """The deterministic change log that the jsonl observer left."""
    return (cwd / summary["outputs"]["changes"]).read_bytes()


def static(cwd: Path) -> list[Row]:
    """Oracle without faults: precision, recall, centre error, connected stops, no collision."""
    from dssmsg.evaluate.recorded import score_recording

    rows = []
    for scene in ("rs_int", "ihlen_1_int"):
        summary = run(cwd, "perception.use=oracle", f"source.scene={scene}")
        result = score_recording(recording_of(summary, cwd))
        score = result.score
        counts = (
            f"({score.true_positives} right, {score.false_positives} wrong, {score.false_negatives} missed)"
        )
        rows += [
            Row(
                f"{scene}: static precision",
                ">= 0.95",
                f"{score.precision:.3f} {counts}",
                score.precision >= 0.95,
            ),
            Row(f"{scene}: static recall", ">= 0.95", f"{score.recall:.3f}", score.recall >= 0.95),
            Row(
                f"{scene}: median centre error",
                "<= 0.10 m",
                f"{score.median_centre_error_m:.3f} m",
                score.median_centre_error_m <= 0.10,
            ),
            Row(
                f"{scene}: driven pairs of stops connected",
                "all",
                f"{result.connected_stops} of {result.stop_pairs}",
                result.connected_stops == result.stop_pairs,
            ),
            Row(f"{scene}: collisions", "0", str(summary["collisions"]), summary["collisions"] == 0),
            Row(
                f"{scene}: frames, key frames",
                "<= 1200, <= 450",
                f"{summary['frames']}, {summary['key_frames']}",
                summary["frames"] <= 1200 and summary["key_frames"] <= 450,
            ),
        ]
        if score.missed or score.wrong:
            names = "; ".join(filter(None, (", ".join(score.missed), ", ".join(score.wrong))))
            rows.append(Row(f"{scene}: missed; wrong", "-", names, None))
    return rows


def survival(cwd: Path) -> list[Row]:
    """kill -9 at ten random moments, and files cut at ten random bytes."""
    rng = random.Random(1)
    lost: list[float] = []
    opened = 0
    for _ in range(10):
        folder = Path(tempfile.mkdtemp(dir=cwd))
        probe = folder / "probe.jsonl"
        process = subprocess.Popen(
            [
                *[sys.executable, "-m", "dssmsg", "run", "--set", "perception.use=oracle"],
                *["--set", f"plugins=[{HERE / 'probe.py'}]", "--set", f"recording.directory={folder}"],
                *["--set", f"recording.observers.probe={{path: {probe}, every: 1}}"],
            ],
            cwd=cwd,
            env=ENVIRONMENT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        while not (probe.exists() and probe.stat().st_size) and process.poll() is None:
            time.sleep(0.1)
        time.sleep(rng.uniform(1.5, 20))
        process.send_signal(signal.SIGKILL)
        killed = time.monotonic()
        process.wait()
        file = next(folder.glob("*.rrd"))
        done = dssmsg("inspect", str(file), "--json", cwd=cwd, check=False)
        if done.returncode != 0:
            continue
        opened += 1
        frames = json.loads(done.stdout)["frames"]
        walls = {line["frame"]: line["wall"] for line in map(json.loads, probe.read_text().splitlines())}
        lost.append(killed - walls[frames - 1] if frames - 1 in walls else 99.0)
    worst = max(lost, default=99.0)
    rows = [
        Row("kill -9 at 10 moments: files that open", "10", str(opened), opened == 10),
        Row("... wall time lost, worst", "<= 3 s", f"{worst:.2f} s", worst <= 3.0),
    ]
    finished = recording_of(run(cwd, "perception.use=oracle", "mission.max_frames=300"), cwd)
    for title, whole in (("the file of a killed run", file), ("a finished file", finished)):
        content, opened, touched, frames = whole.read_bytes(), 0, 0, []
        for _ in range(10):
            cut = cwd / "cut.rrd"
            cut.write_bytes(content[: rng.randrange(len(content) // 20, len(content))])
            before = cut.read_bytes()
            done = dssmsg("inspect", str(cut), "--json", cwd=cwd, check=False)
            opened += done.returncode == 0
            if done.returncode == 0:
                frames.append(json.loads(done.stdout)["frames"])
            touched += cut.read_bytes() != before
        rows += [
            Row(f"{title} cut at 10 random bytes: files that open", "10", str(opened), opened == 10),
            Row("... frames read", "reported", f"{min(frames, default=0)} to {max(frames, default=0)}", None),
            Row("... originals touched", "0", str(touched), touched == 0),
        ]
    return rows


def camera(cwd: Path) -> list[Row]:
    """Frames a second of the ray-cast camera on one core, and its agreement with TinyRenderer."""
    command = ["taskset", "-c", "0", sys.executable, str(HERE / "camera.py"), "--json", "--assets", "real"]
    rows = []
    for scenes in ([], ["--scene", "rs_int", "--scene", "ihlen_1_int"]):
        done = subprocess.run(
            [*command, *scenes], cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=True
        )
        few, many = json.loads(done.stdout)
        if few["renderer"] != "raycast":
            raise SystemExit("this measures Open3D's camera; dssmsg doctor says why it does not load")
        fps, ratio = few["frames_per_second"], many["ms"] / few["ms"]
        name = f"camera, {few['scene']} with {few['pieces']} real pieces, one core"
        rows += [
            Row(name, ">= 30 frames/s", f"{fps:.1f}", fps >= 30),
            Row(f"... cost with {many['pieces']} pieces", "<= 1.5 x", f"{ratio:.2f} x", ratio <= 1.5),
        ]
        for one in (few, many):
            same = one["same_ids"]
            name = f"... agreement with TinyRenderer, {one['scene']}"
            rows.append(Row(name, ">= 98 %", f"{100 * same:.2f} %", same >= 0.98))
    return rows


def association(cwd: Path) -> list[Row]:
    """Association time against map size, and against exhaustive nearest neighbours."""
    done = subprocess.run(
        [sys.executable, str(HERE / "association.py"), "--json"],
        cwd=cwd,
        env={**ENVIRONMENT, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    figures = json.loads(done.stdout)
    growth, speedup = figures["map_growth"], figures["brute_speedup"]
    milliseconds = figures["frame_ms@50"]
    return [
        Row("association, 2,000 against 100 objects", "<= 1.5 x", f"{growth:.2f} x", growth <= 1.5),
        Row("association, against exhaustive at 50", ">= 10 x", f"{speedup:.0f} x", speedup >= 10),
        Row("association, time a frame at 50", "(aim 15 ms)", f"{milliseconds:.1f} ms", None),
    ]


def cost(cwd: Path) -> list[Row]:
    """The default run: wall time, size, memory; and what the recording costs, interleaved."""
    with_recording, without = [], []
    for _ in range(5):
        with_recording.append(run(cwd, "perception.use=oracle"))
        without.append(run(cwd, "perception.use=oracle", "recording.observers.rerun=false"))
    walls = [statistics.median(r["wall"] for r in runs) for runs in (with_recording, without)]
    size = recording_of(with_recording[0], cwd).stat().st_size / 1e6
    peak = max(r["peak_mb"] for r in with_recording)
    return [
        Row(
            "default run with oracle, wall time, median of 5", "<= 90 s", f"{walls[0]:.1f} s", walls[0] <= 90
        ),
        Row(
            "... against without recording",
            "<= 1.25 x",
            f"{walls[0] / walls[1]:.2f} x",
            walls[0] / walls[1] <= 1.25,
        ),
        Row("... size of the recording", "<= 100 MB", f"{size:.1f} MB", size <= 100),
        Row("... peak memory", "<= 1500 MB", f"{peak:.0f} MB", peak <= 1500),
    ]


def growth(cwd: Path) -> list[Row]:
    """5,000 frames: memory in the second half."""
    probe = cwd / "memory.jsonl"
    run(
        cwd,
        "perception.use=oracle",
        "mission.max_frames=5000",
        f"mission.phases=[survey{', revisit' * 14}]",
        "source.visits=15",
        f"plugins=[{HERE / 'probe.py'}]",
        f"recording.observers.probe={{path: {probe}, every: 25}}",
    )
    lines = [json.loads(line) for line in probe.read_text().splitlines()]
    half = [line["mb"] for line in lines if line["frame"] >= 2500]
    middle = statistics.median(half[: len(half) // 5])
    end = statistics.median(half[-len(half) // 5 :])
    ratio = end / middle
    return [
        Row("5,000 frames: frames seen", ">= 4900", str(lines[-1]["frame"]), lines[-1]["frame"] >= 4900),
        Row("... memory, end against middle", "within 5 %", f"{middle:.0f} -> {end:.0f} MB", ratio <= 1.05),
        Row("... peak resident memory", "<= 1500 MB", f"{max(x['mb'] for x in lines):.0f} MB", None),
    ]


def startup(cwd: Path) -> list[Row]:
    """`dssmsg --help` against a bare Typer program, interleaved."""
    bare = cwd / "bare.py"
    bare.write_text("import typer\napp = typer.Typer()\n@app.command()\ndef main(): ...\napp()\n")
    times: dict[str, list[float]] = {"dssmsg": [], "bare": []}
    for _ in range(15):
        for name, command in (("dssmsg", ["-m", "dssmsg"]), ("bare", [str(bare)])):
            start = time.monotonic()
            subprocess.run(
                [sys.executable, *command, "--help"],
                env=ENVIRONMENT,
                capture_output=True,
                check=True,
                cwd=cwd,
            )
            times[name].append(time.monotonic() - start)
    ratio = statistics.median(times["dssmsg"]) / statistics.median(times["bare"])
    return [Row("dssmsg --help against a bare Typer program", "(aim 1.3 x)", f"{ratio:.2f} x", None)]


STAGES: dict[str, Callable[[Path], list[Row]]] = {
    "folding": folding,
    "determinism": determinism,
    "static": static,
    "survival": survival,
    "camera": camera,
    "association": association,
    "cost": cost,
    "growth": growth,
    "startup": startup,
}
