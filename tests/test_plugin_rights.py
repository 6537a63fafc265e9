"""What plug-ins are given: a graph that cannot be written, and neighbours that are checked."""

from __future__ import annotations

import numpy as np
import pytest

from dssmsg.errors import PluginError
from dssmsg.graph.changes import Cause, WaypointAdded
from dssmsg.graph.read_only import ReadOnlyGraph
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.view import GraphView
from dssmsg.interfaces import Answer
from dssmsg.mission.checked_encoder import CheckedEncoder
from dssmsg.mission.llm_log import LoggedLlm


def test_the_graph_of_a_plugin_has_everything_but_apply():
    graph = SceneGraph()
    view = ReadOnlyGraph(graph)
    wanted = {name for name in vars(GraphView) if not name.startswith("_")}
    assert wanted <= {name for name in dir(view) if not name.startswith("_")}
    assert not hasattr(view, "apply")
    assert not hasattr(view, "apply_all")
    graph.apply(WaypointAdded(cause=Cause("t", "t"), waypoint_id="waypoint-1", position=np.zeros(3)))
    assert list(view.waypoints) == ["waypoint-1"]
    with pytest.raises(TypeError):
        view.waypoints["waypoint-2"] = graph.waypoints["waypoint-1"]  # type: ignore[index]


class Encoder:
    space, dimension = "test/3", 3

    def __init__(self, vectors):
        self.vectors = np.asarray(vectors, np.float32)

    def encode_labels(self, labels):
        return self.vectors

    encode_text = encode_labels

    def encode_crops(self, crops):
        return None


@pytest.mark.parametrize("vectors", [[[np.nan, 0, 0]], [[2, 0, 0]], [[1, 0]], [[1, 0, 0], [1, 0, 0]]])
def test_wrong_vectors_are_the_encoders_fault(vectors):
    with pytest.raises(PluginError, match="encoder/bad"):
        CheckedEncoder(Encoder(vectors), "encoder/bad").encode_labels(["chair"])


def test_right_vectors_pass():
    checked = CheckedEncoder(Encoder([[1, 0, 0]]), "encoder/good")
    assert checked.encode_text(["chair"]).tolist() == [[1, 0, 0]]
    assert checked.encode_crops([]) is None


def test_an_answer_that_does_not_fit_is_refused_and_told():
    class Llm:
        def complete(self, role, messages, schema):
            return Answer({"kind": "bogus"}, "bogus")

    told = []
    llm = LoggedLlm(Llm(), "bad", told.append, lambda: (7, 1.4))
    schema = {"type": "object", "properties": {"kind": {"enum": ["explicit"]}}}
    with pytest.raises(PluginError, match="llm/bad"):
        llm.complete("target_graph", (), schema)
    (call,) = told
    assert (call.ok, call.frame) == (False, 7)
    assert "does not fit" in call.error
