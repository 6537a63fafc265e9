"""Source `recording` and perception `recorded`: an earlier run again, as other plug-ins see it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dssmsg_plugins.perception import recorded
from dssmsg_plugins.source import recording as source
from pydantic import ValidationError
from recorded_run import SyntheticRun, context, record

from dssmsg.errors import InputError
from dssmsg.interfaces import Perception, Source
from dssmsg.interfaces.source import Command
from dssmsg.recording.rows import truth_objects_json

FRAMES = 24


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(SyntheticRun(FRAMES), tmp_path_factory.mktemp("replay") / "run.rrd", images="lossless")


def make(path: Path, **options: object) -> source.RecordedSource:
    config = source.Config.model_validate({"recording": path.name, **options})
    return source.RecordedSource(config, context(path.parent, base_dir=path.parent))


def drain(replay: source.RecordedSource) -> list[list]:
    visits = []
    for visit in range(replay.info.visits or 0):
        replay.start_visit(visit)
        frames = []
        while (frame := replay.step(Command(linear=9.0))) is not None:
            frames.append(frame)
        visits.append(frames)
    replay.close()
    replay.close()
    return visits


def test_the_source_gives_the_same_frames_again(path: Path) -> None:
    replay = make(path)
    assert isinstance(replay, Source)
    info = replay.info
    assert (info.name, info.drivable, info.visits, info.has_truth) == ("recording", False, 2, True)
    assert (info.scene, info.facts["parent"], info.facts["recorded_by"]) == ("ring", "synthetic", "synthetic")
    assert info.credits == ("furniture: nobody",)
    assert replay.collisions() == 0
    frames = [frame for visit in drain(replay) for frame in visit]
    again = SyntheticRun(FRAMES)
    assert len(frames) == FRAMES
    for frame in frames:
        events = {type(event).__name__: event for event in again.frame_events(frame.index)}
        want, truth = events["FrameCaptured"].frame, events["TruthSeen"].truth
        assert np.array_equal(frame.rgb, want.rgb)
        assert np.array_equal(frame.depth, want.depth)
        assert np.array_equal(frame.world_from_camera, want.world_from_camera)
        assert (frame.visit, frame.at_stop, frame.sim_time) == (want.visit, want.at_stop, want.sim_time)
        assert frame.truth is not None
        assert truth_objects_json(frame.truth.objects) == truth_objects_json(truth.objects)
        assert np.array_equal(frame.truth.instance_ids, truth.instance_ids)


def test_a_part_of_it_without_truth(path: Path) -> None:
    replay = make(path, start=5, stop=9, truth=False)
    assert not replay.info.has_truth
    (frames,) = drain(replay)
    assert [frame.index for frame in frames] == [5, 6, 7, 8]
    assert all(frame.truth is None for frame in frames)


def test_collisions_are_those_of_the_frame(path: Path) -> None:
    replay = make(path, start=18)
    replay.start_visit(0)
    assert replay.step(None) is not None
    assert replay.collisions() == 1
    with pytest.raises(InputError, match="no visit 3"):
        replay.start_visit(3)
    replay.close()


def test_the_newest_of_a_folder(path: Path) -> None:
    config = source.Config(recording=Path())
    replay = source.RecordedSource(config, context(path.parent, base_dir=path.parent))
    assert len(drain(replay)) == 2


def test_what_cannot_be_replayed_is_said(path: Path) -> None:
    with pytest.raises(InputError, match="no such recording"):
        make(path.with_name("none.rrd"))
    with pytest.raises(InputError, match="holds no frame from 900 on"):
        make(path, start=900)
    with pytest.raises(ValidationError, match="recording"):
        source.Config.model_validate({})


def test_recorded_perception_gives_what_was_detected(path: Path) -> None:
    config = recorded.Config(recording=Path(path.name))
    perception = recorded.RecordedPerception(config, context(path.parent, base_dir=path.parent))
    assert isinstance(perception, Perception)
    assert perception.feature_space == "toy/8"
    again = SyntheticRun(FRAMES)
    detected = 0
    for index in range(FRAMES):
        events = {type(event).__name__: event for event in again.frame_events(index)}
        frame = events["FrameCaptured"].frame
        got = perception.detect(frame)
        want = events["Detected"].detections if "Detected" in events else ()
        assert [detection.label for detection in got] == [detection.label for detection in want]
        for ours, theirs in zip(got, want, strict=True):
            assert np.array_equal(ours.mask, theirs.mask)
        detected += len(got)
    assert detected > 10


def test_recorded_perception_refuses_frames_of_another_size(path: Path) -> None:
    config = recorded.Config(recording=Path(path.name))
    perception = recorded.RecordedPerception(config, context(path.parent, base_dir=path.parent))
    other = SyntheticRun(1, width=32, height=24).frame(0)
    with pytest.raises(ValueError, match="does the source replay this recording"):
        perception.detect(other)


def test_a_recording_without_detections_is_refused(tmp_path: Path) -> None:
    from dssmsg import events as ev
    from dssmsg.recording.repair import optimize
    from dssmsg.recording.writer import RecordingWriter

    run = SyntheticRun(3)
    writer = RecordingWriter(tmp_path / "blind.rrd", "blind")
    for event in run.events():
        if not isinstance(event, ev.Detected):
            writer.write(event)
    writer.close()
    optimize(tmp_path / "blind.rrd")
    with pytest.raises(InputError, match="holds no detections"):
        recorded.RecordedPerception(
            recorded.Config(recording=Path("blind.rrd")), context(tmp_path, base_dir=tmp_path)
        )
