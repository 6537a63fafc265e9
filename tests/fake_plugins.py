"""The smallest plug-in of every kind that a run needs: what the host's and the CLI's tests run with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from dssmsg.events import Event, GraphChanged, RunFinished
from dssmsg.frame import Camera, Detection, Frame, Observation, quantise_depth
from dssmsg.graph.changes import Cause, Change, ObjectAdded
from dssmsg.hookspecs import PluginConfig, Register, hookimpl
from dssmsg.interfaces import Answer, Command, Context, SourceInfo, Step, UpdateResult

CAMERA = Camera.from_fov(32, 24, 1.2)


class SourceConfig(PluginConfig):
    frames: int = Field(3, ge=0, description="Frames of the one visit.")
    width: int = Field(32, ge=8, description="Width of the images that come, announced are 32.")


class FakeSource:
    """A wall 2 m ahead of a camera that advances 0.6 m a frame, so that every frame is a key frame."""

    def __init__(self, config: SourceConfig, context: Context) -> None:
        self._config = config
        self._index = 0

    @property
    def info(self) -> SourceInfo:
        return SourceInfo(
            name="fake", camera=CAMERA, drivable=False, has_truth=False, credits=("a wall by nobody",)
        )

    def start_visit(self, visit: int) -> None:
        pass

    def step(self, command: Command | None) -> Frame | None:
        index = self._index
        if index >= self._config.frames:
            return None
        self._index += 1
        camera = Camera.from_fov(self._config.width, 24, 1.2)
        size = (camera.height, camera.width)
        pose = np.array(
            [[0, 0, 1, 0.6 * index], [-1, 0, 0, 0], [0, -1, 0, 0.8], [0, 0, 0, 1]], dtype=np.float64
        )
        base = np.eye(4)
        base[0, 3] = 0.6 * index
        depth = quantise_depth(np.full(size, 2.0))
        return Frame(index, 0.2 * index, np.full((*size, 3), 90, np.uint8), depth, camera, pose, base)

    def collisions(self) -> int:
        return 0

    def close(self) -> None:
        pass


class FakePerception:
    """One square in the middle of every frame."""

    feature_space = None

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def detect(self, frame: Frame) -> Sequence[Detection]:
        mask = np.zeros(frame.depth.shape, bool)
        mask[6:18, 8:24] = True
        return [Detection(mask, np.array([8, 6, 23, 17]), "square", 0.9)]


class FakeEncoder:
    space, dimension = "fake/4", 4

    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def encode_labels(self, labels: Sequence[str]) -> Any:
        return np.tile(np.float32([1, 0, 0, 0]), (len(labels), 1))

    def encode_text(self, texts: Sequence[str]) -> Any:
        return self.encode_labels(texts)

    def encode_crops(self, crops: Sequence[Any]) -> Any:
        return None


class FakeLlm:
    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def complete(self, role: str, messages: Sequence[Any], schema: Any) -> Answer:
        value = {"kind": "explicit", "nodes": [{"label": "square"}], "edges": [], "core": 0}
        return Answer(value, str(value))


class FakeAssociation:
    """Every observation is a new object."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        self._ids = context.ids

    def associate(
        self, frame: Frame, observations: Sequence[Observation], viewpoint_id: str | None
    ) -> Sequence[Change]:
        return [
            ObjectAdded(
                cause=Cause("association/fake", "always new"),
                object_id=self._ids.new("object"),
                label=one.label,
                score=one.score,
                points=one.points_world,
                colors=one.colors,
                viewpoint_id=viewpoint_id,
                range_m=one.range_m,
                detection=one.detection_index,
            )
            for one in observations
        ]

    def finish(self) -> Sequence[Change]:
        return ()


class FakeUpdate:
    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def update(
        self, frame: Frame, observations: Any, object_ids: Any, viewpoint_id: str | None
    ) -> UpdateResult:
        return UpdateResult()

    def finish(self) -> UpdateResult:
        return UpdateResult()


class FakeGrounding:
    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def ground(self, target: Any) -> Sequence[Any]:
        return ()


class FakeNavigation:
    def __init__(self, config: PluginConfig, context: Context) -> None:
        pass

    def start(self, frame: Frame, goals: Sequence[str]) -> None:
        pass

    def step(self, frame: Frame) -> Step:
        return Step(Command(), "arrived", outcome="success")


class FakeObserver:
    """Writes one line a frame with changes; `<run>.txt`."""

    def __init__(self, config: PluginConfig, context: Context) -> None:
        self._path = Path(context.run_dir) / f"{context.run_id}.txt"
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self._path.open("x", encoding="utf-8")

    def on_event(self, event: Event) -> None:
        if isinstance(event, GraphChanged):
            self._stream.write(f"{event.frame} {[change.kind for change in event.changes]}\n")
        if isinstance(event, RunFinished):
            self._stream.write("finished\n")
        self._stream.flush()

    def close(self) -> None:
        self._stream.close()

    def outputs(self) -> dict[str, str]:
        return {"recording": str(self._path)}


@hookimpl
def register_source(register: Register) -> None:
    register("fake", FakeSource, config=SourceConfig)


@hookimpl
def register_perception(register: Register) -> None:
    register("fake", FakePerception)


@hookimpl
def register_encoder(register: Register) -> None:
    register("fake", FakeEncoder)


@hookimpl
def register_llm(register: Register) -> None:
    register("fake", FakeLlm)


@hookimpl
def register_association(register: Register) -> None:
    register("fake", FakeAssociation)


@hookimpl
def register_update(register: Register) -> None:
    register("fake", FakeUpdate)


@hookimpl
def register_grounding(register: Register) -> None:
    register("fake", FakeGrounding)


@hookimpl
def register_navigation(register: Register) -> None:
    register("fake", FakeNavigation)


@hookimpl
def register_observer(register: Register) -> None:
    register("fake", FakeObserver)
