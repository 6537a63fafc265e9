"""Each rule of diagnosis on a told episode: silent while it is sound, and what is said of a spoilt one."""

from __future__ import annotations

import pytest
from dssmsg_plugins.diagnosis import (
    association,
    depth,
    detection,
    language,
    matching,
    motion,
    pose,
    route,
    update,
    way,
)
from episode_story import BED, LAST, SOFA, SURVEY, Story, changed, evidence, sighting, step

from dssmsg.checks import check_findings
from dssmsg.interfaces import Command

RULES = {
    "association": association.AssociationRule(association.Config()),
    "depth": depth.DepthRule(depth.Config()),
    "detection": detection.DetectionRule(detection.Config()),
    "language": language.LanguageRule(language.Config()),
    "matching": matching.MatchingRule(matching.Config()),
    "motion": motion.MotionRule(motion.Config()),
    "pose": pose.PoseRule(pose.Config()),
    "route": route.RouteRule(route.Config()),
    "update": update.UpdateRule(update.Config()),
    "way": way.WayRule(way.Config()),
}


def say(rule, story):
    return check_findings(RULES[rule].diagnose(story, 0))


@pytest.fixture
def story():
    return Story()


@pytest.mark.parametrize("truth", [False, True])
@pytest.mark.parametrize("rule", sorted(set(RULES) - {"pose"}))
def test_a_sound_episode_says_nothing(rule, truth):
    assert not say(rule, Story().with_truth() if truth else Story())


def test_nothing_is_said_of_a_whole_run(story):
    assert not [found for rule in RULES.values() for found in rule.diagnose(story, None)]


# detection


def test_a_name_that_was_never_given(story):
    story.found = {frame: ["bed"] for frame in story.found}
    story.ended |= {"outcome": "failure", "reason": "wrong match"}
    (found,) = say("detection", story)
    assert (found.layer, found.basis) == ("detector", "recording")
    assert found.confidence < 0.8


def test_what_was_truly_in_view_and_not_detected(story):
    story.with_truth().found = {frame: ["wardrobe", "bed"] for frame in story.found}
    (found,) = say("detection", story)
    assert (found.layer, found.basis, found.frame) == ("detector", "truth", 1)
    assert "called wardrobe" in found.summary
    assert found.decision.margin == pytest.approx(-0.5)


def test_a_thing_that_is_called_like_the_target(story):
    """The robot took for the sofa what is truly the bed."""
    story.with_truth().rows = [row for row in story.rows if row.get("object_id") != "object-1"]
    story.rows += [sighting("object-1", "sofa", frame, 1, BED[1], first=frame == 1) for frame in (1, 2, 3)]
    said = [found for found in say("detection", story) if found.focus == "object-1"]
    assert [found.basis for found in said] == ["truth"]
    assert "bed-2 (bed) a sofa" in said[0].summary


def test_nobody_is_blamed_where_the_home_has_none(story):
    story.with_truth()
    story.things = story.things[1:]
    story.found = {frame: ["bed"] for frame in story.found}
    assert not say("detection", story)


# association


def test_detections_that_never_became_one_object(story):
    story.rows = [row for row in story.rows if row.get("object_id") != "object-1"]
    story.rows += [sighting(f"object-{10 + f}", "sofa", f, 0, SOFA[1], first=True) for f in (1, 2, 3)]
    (found,) = say("association", story)
    assert (found.layer, found.frame) == ("association", 1)
    assert "3 detections of a sofa became 3 objects" in found.summary


def without_the_sofa():
    """A story in whose map the sofa is not."""
    story = Story()
    story.rows = [row for row in story.rows if "object-1" not in (row.get("object_id"), row.get("target"))]
    return story


def test_two_pieces_in_one_place_are_enough():
    story = without_the_sofa()
    story.rows += [sighting(f"object-{n}", "sofa", n, 0, SOFA[1], first=True) for n in (5, 6)]
    (found,) = say("association", story)
    assert 0.55 < found.confidence < 0.85
    assert "2 detections of a sofa became 2 objects" in found.summary


def test_two_that_were_seen_once_each_are_no_pieces():
    story = without_the_sofa()
    story.rows += [
        sighting("object-5", "sofa", 5, 0, SOFA[1], first=True),
        sighting("object-6", "sofa", 6, 0, (9.0, 9.0, 0.0, 9.5, 9.5, 0.8), first=True),
    ]
    assert not say("association", story)


def test_one_that_can_be_found_does_not_excuse_a_heap_of_pieces(story):
    story.rows += [sighting(f"object-{n}", "sofa", n, 0, SOFA[1], first=True) for n in range(4, 11)]
    (found,) = say("association", story)
    assert "10 detections of a sofa became 8 objects" in found.summary


@pytest.mark.parametrize("truth", [False, True])
def test_one_detection_that_truly_was_the_target_and_went_elsewhere(truth):
    story = without_the_sofa()
    story.rows.append(sighting("object-2", "sofa", 3, 0, SOFA[1]))
    told = [
        (found.basis, found.confidence)
        for found in say("association", story.with_truth() if truth else story)
    ]
    assert told == ([("truth", 0.8)] if truth else [])


def test_detections_that_were_put_into_something_else(story):
    story.rows = [row for row in story.rows if row.get("object_id") != "object-1"]
    story.rows += [sighting("object-2", "sofa", frame, 0, SOFA[1]) for frame in (1, 2)]
    story.rows += [sighting("object-2", "bed", frame, 1, BED[1]) for frame in (2, 3)]
    story.rows += [sighting("object-2", "sofa", 3, 0, SOFA[1])]
    (found,) = [one for one in say("association", story) if "were put into" in one.summary]
    assert found.layer == "association"
    assert "into object-2 (bed)" in found.summary
    assert "s 1.90 against 1.1" in found.events[0]


def test_two_things_in_one_by_the_truth(story):
    story.with_truth().rows += [sighting("object-1", "sofa", frame, 1, SOFA[1]) for frame in (4, 5, 6)]
    (found,) = say("association", story)
    assert found.basis == "truth"
    assert found.decision.value == pytest.approx(0.5)


# update


def test_called_gone_without_evidence(story):
    story.rows.append(changed("object-1", 8, state="disappeared"))
    (found,) = say("update", story)
    assert (found.layer, found.frame, found.focus) == ("update", 8, "object-1")
    assert found.decision.value == 0.0


def test_called_gone_with_evidence_is_right(story):
    story.rows.append(changed("object-1", 8, state="disappeared"))
    story.told_windows = evidence("object-1", {5: "missed", 6: "missed", 7: "missed"})
    assert not say("update", story)


def test_called_gone_though_it_truly_stands_there(story):
    story.with_truth().rows.append(changed("object-1", 8, state="disappeared"))
    story.told_windows = evidence("object-1", {5: "missed", 6: "missed", 7: "missed"})
    (found,) = say("update", story)
    assert (found.layer, found.basis) == ("update", "truth")


def test_left_in_though_its_place_was_shown_free(story):
    story.drive[-1] = step(LAST, "missing", "object-1 is not in view from viewpoint-2.1")
    story.told_windows = evidence("object-1", {7: "missed", 8: "missed", 9: "missed", 10: "missed"})
    (found,) = say("update", story.spoilt())
    assert (found.layer, found.frame) == ("update", 9)


def test_nobody_could_know_that_it_had_gone(story):
    story.drive[-1] = step(LAST, "missing", "object-1 is not in view from viewpoint-2.1")
    story.told_windows = evidence("object-1", {29: "missed"})
    assert not say("update", story.spoilt())


# language


def test_no_target_graph(story):
    story.matched = None
    story.calls[0] |= {"ok": False, "error": "connection refused"}
    (found,) = say("language", story.spoilt(reason="no target graph"))
    assert found.layer == "grounding"
    assert "connection refused" in found.summary


def test_a_target_graph_for_another_thing(story):
    story.matched["target"]["nodes"][0]["label"] = "bed"
    (found,) = say("language", story)
    assert (found.layer, found.frame, found.confidence) == ("grounding", SURVEY - 1, 0.9)


@pytest.mark.parametrize(("core", "layers"), [("sofa", ["grounding"]), ("bed", [])])
def test_a_sentence_that_names_nothing_is_read_again(story, core, layers):
    story.ended["goal"] = story.matched["query"] = "somewhere to lie down and sleep"
    story.matched["target"]["nodes"][0]["label"] = core
    assert [found.layer for found in say("language", story)] == layers


# matching


def test_a_score_that_does_not_follow_from_its_terms(story):
    story.matched["candidates"][1]["scores"]["score"] += 0.4
    found = next(one for one in say("matching", story) if "weights" in one.summary)
    assert found.layer == "matching"
    assert found.decision.margin == pytest.approx(0.4)


def test_a_lower_score_that_came_first(story):
    story.matched["candidates"].reverse()
    said = [one.summary for one in say("matching", story)]
    assert any("has the higher score" in one for one in said)
    assert any("bed" in one and "there is object-1 (sofa)" in one for one in said)


def test_a_viewpoint_that_never_saw_it(story):
    story.matched["candidates"][0]["viewpoint"] = "viewpoint-1.1"
    (found,) = say("matching", story)
    assert "never seen from there" in found.summary


def test_nothing_matched_though_it_is_in_the_map(story):
    story.matched["candidates"] = []
    (found,) = say("matching", story)
    assert "object-1" in found.summary


def test_other_weights_are_not_judged_by_ours(story):
    story.matched["candidates"][1]["scores"]["score"] += 0.1
    story.options = {"grounding": {"use": "image"}}
    assert not say("matching", story)


# route


def test_no_way_though_there_is_one(story):
    story.drive = [step(SURVEY - 1, "stop", "to viewpoint-2.1")]
    story.poses_xy = dict.fromkeys(story.indices, (0.0, 0.0, 0.0))
    (found,) = say("route", story.spoilt(reason="no path"))
    assert (found.layer, found.focus) == ("planner", "waypoint-2")


def test_no_way_where_there_is_none(story):
    story.rows = [row for row in story.rows if row.get("edge") != "path"]
    story.matched["candidates"] = story.matched["candidates"][:1]
    story.drive = [step(SURVEY - 1, "stop", "to viewpoint-2.1")]
    story.poses_xy = dict.fromkeys(story.indices, (0.0, 0.0, 0.0))
    assert not say("route", story.spoilt(reason="no path"))


def test_a_way_to_where_no_candidate_is(story):
    story.drive[0] = step(SURVEY - 1, "drive", "to waypoint-1", ["waypoint-1"])
    assert [found.layer for found in say("route", story)] == ["planner"]


def test_no_way_at_all_to_where_no_candidate_is(story):
    """It stays where it is and looks along another viewpoint than the best candidate's."""
    story.drive = [
        step(SURVEY, "look", "along viewpoint-1.1"),
        step(LAST, "missing", "not from viewpoint-1.1"),
    ]
    story.poses_xy = dict.fromkeys(story.indices, (0.0, 0.0, 0.0))
    (found,) = say("route", story.spoilt())
    assert "the way leads to waypoint-1, though free edges lead to waypoint-2" in found.summary


def test_a_look_from_elsewhere(story):
    story.poses_xy |= dict.fromkeys((28, 29), (0.5, 0.0, 0.0))
    (found,) = say("route", story)
    assert found.decision.value == pytest.approx(2.5)


# motion, pose, depth, way


@pytest.mark.parametrize("done", [0.0, 0.4, 1.6])
def test_wheels_that_do_not_do_what_they_are_told(story, done):
    story.poses_xy = {i: (x * done, y, heading) for i, (x, y, heading) in story.poses_xy.items()}
    (found,) = say("motion", story)
    assert (found.layer, found.frame) == ("control", SURVEY)
    assert found.decision.value == pytest.approx(done, abs=0.01)


def test_turning_too_little(story):
    story.commands = {i: Command(angular=0.5) for i in story.indices}
    story.poses_xy = {i: (0.0, 0.0, 0.02 * (i - SURVEY + 1)) for i in story.indices}
    (found,) = say("motion", story)
    assert "turning" in found.summary


def test_short_turns_with_a_lag_are_done_in_full(story):
    """Each turn begins a period late and ends one after the last command."""
    asked = {i: 0.6 if i % 4 in (0, 1) else 0.0 for i in story.indices}
    story.commands = {i: Command(angular=turn) for i, turn in asked.items()}
    heading, told = 0.0, {}
    for i in story.indices:
        heading += 0.2 * asked.get(i - 1, 0.0) if i > SURVEY else 0.0
        told[i] = (0.0, 0.0, heading)
    story.poses_xy = told
    assert not say("motion", story)


def test_veering_off(story):
    story.poses_xy = {i: (x, y, 0.08 * max(0, i - SURVEY)) for i, (x, y, _) in story.poses_xy.items()}
    assert any("beside what it was told" in found.summary for found in say("motion", story))


def test_a_pose_that_jumps_is_not_the_motors_doing(story):
    story.poses_xy |= {i: (x + 1.5 * (i >= 20), y, h) for i, (x, y, h) in story.poses_xy.items()}
    (found,) = say("pose", story)
    assert (found.layer, found.frame) == ("environment", 20)
    assert not say("motion", story)


def standing(story, step_m, *, first=20):
    """The story's robot is to stand from a frame on, and its pose goes on by so much a period."""
    story.commands |= {i: Command() for i in range(first, LAST + 1)}
    x, y, heading = story.poses_xy[first]
    story.poses_xy |= {i: (x + step_m * (i - first), y, heading) for i in range(first, LAST + 1)}
    return story


def test_a_pose_that_travels_while_the_wheels_stand(story):
    (found,) = say("pose", standing(story, 0.03))
    assert (found.layer, found.basis) == ("environment", "recording")
    assert 20 < found.frame < 24
    assert found.decision.value == pytest.approx(0.03)
    assert found.confidence > max((one.confidence for one in say("motion", story)), default=0.0)


def test_noise_of_a_pose_goes_nowhere(story):
    standing(story, 0.0)
    for i in range(20, LAST + 1):
        x, y, heading = story.poses_xy[i]
        story.poses_xy[i] = (x + 0.02 * (-1) ** i, y, heading)
    assert not say("pose", story)


def test_a_steady_pose_says_nothing(story):
    assert not say("pose", story)


def test_lost_depth_is_found_to_the_frame(story):
    told = story.frame
    story.frame = lambda index, **_: told(index) if index < 20 else _dark(told(index))
    (found,) = say("depth", story)
    assert (found.layer, found.frame) == ("environment", 20)


def _dark(frame):
    import dataclasses

    return dataclasses.replace(frame, depth=frame.depth * 0)


@pytest.mark.parametrize(("depth_m", "layer"), [(2.0, "environment"), (2.8, "planner")])
def test_an_obstacle_is_looked_up_in_the_depth_images(story, depth_m, layer):
    """The robot looks east from x = 3; something is said to stand at x = 5."""
    story.poses_xy = dict.fromkeys(story.indices, (3.0, 0.0, 0.0))
    x = 3.0 + 2.0
    story.drive[-1] = step(LAST, "stop", f"something at {x:.2f} 0.00 on the way to waypoint-2")
    story.frame = _floor_and(story, depth_m)
    (found,) = say("way", story.spoilt(reason="blocked"))
    assert found.layer == layer


def test_an_obstacle_that_sends_the_robot_to_another_place(story):
    story.poses_xy = dict.fromkeys(story.indices, (3.0, 0.0, 0.0))
    story.drive = [
        step(SURVEY, "replan", "something at 5.00 0.00 on the way to waypoint-2"),
        step(LAST, "look", "along viewpoint-1.1"),
    ]
    story.frame = _floor_and(story, 2.0)
    (found,) = say("way", story.spoilt())
    assert (found.layer, found.frame) == ("environment", SURVEY)


def test_an_obstacle_on_the_way_to_where_it_got_is_no_cause(story):
    story.poses_xy = dict.fromkeys(story.indices, (3.0, 0.0, 0.0))
    story.drive.insert(1, step(SURVEY, "replan", "something at 5.00 0.00 on the way to waypoint-2"))
    story.frame = _floor_and(story, 2.0)
    assert not say("way", story.spoilt())


def _floor_and(story, distance):
    """A frame that shows the floor, and a wall at a distance."""
    import dataclasses

    import numpy as np

    from dssmsg.frame import quantise_depth

    told = Story.frame

    def frame(index, **_):
        made = told(story, index)
        rows = np.arange(made.camera.height)[:, None] * np.ones((1, made.camera.width))
        with np.errstate(divide="ignore"):
            floor = np.where(
                rows > made.camera.cy, 0.8 * made.camera.fy / np.maximum(rows - made.camera.cy, 1e-9), np.inf
            )
        return dataclasses.replace(made, depth=quantise_depth(np.minimum(floor, distance)))

    return frame
