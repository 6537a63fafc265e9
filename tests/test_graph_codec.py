"""Changes and graphs as JSON: exact, deterministic, and clear about what is malformed."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest
from graph_strategies import CAUSE, batches, cloud, unit
from hypothesis import given, settings
from hypothesis import strategies as st

from dssmsg.errors import ConfigError, InputError
from dssmsg.graph import changes as c
from dssmsg.graph.codec import blob_hash, canonical_json, decode, encode, graph_from_json, graph_to_json
from dssmsg.graph.export import FORMATS, export_graph
from dssmsg.graph.scene_graph import SceneGraph
from dssmsg.graph.spark_dsg import symbol
from dssmsg.graph.values import json_value


def an_addition() -> c.ObjectAdded:
    """A change with everything in it, floats that are long to spell included."""
    return c.ObjectAdded(
        cause=c.Cause("association/dssm", "new"),
        scores=(c.Score("s", 0.1 + 0.2, 1.1), c.Score("s_geo", 1e-300)),
        frame=3,
        sim_time=1 / 3,
        update=17,
        after={"label": "Spüle", "points": 40},
        object_id="object-12",
        label="Spüle",
        score=2 / 3,
        viewpoint_id="viewpoint-3.2",
        range_m=np.float32(1.1),
        text_feature=unit(1),
        **cloud(1, 40),
    )


def test_a_change_comes_back_bit_for_bit() -> None:
    change = an_addition()
    row, blobs = encode(change)
    back = decode(json.loads(canonical_json(row)), blobs)
    for field in fields(change):
        old, new = getattr(change, field.name), getattr(back, field.name)
        if isinstance(old, np.ndarray):
            assert (old.dtype, old.shape, old.tobytes()) == (new.dtype, new.shape, new.tobytes())
            assert not new.flags.writeable
        else:
            assert old == new, field.name
    assert encode(back) == (row, blobs)


def test_a_row_holds_hashes_instead_of_clouds_and_equal_arrays_once() -> None:
    row, blobs = encode(an_addition())
    assert row["points"] == {"blob": blob_hash(an_addition().points), "dtype": "<f4", "shape": [40, 3]}
    assert row["image_feature"] is None
    assert set(blobs) == {row[name]["blob"] for name in ("points", "colors", "text_feature")}
    assert row["subjects"] == ["object-12"]
    assert len(canonical_json(row)) < 800
    other, more = encode(c.ObjectReplaced(cause=CAUSE, object_id="object-1", **cloud(1, 40)))
    assert other["points"]["blob"] == row["points"]["blob"]
    assert set(more) < set(blobs)


def test_a_hash_tells_dtype_and_shape_apart() -> None:
    zeros = [
        np.zeros(4, np.float32),
        np.zeros((2, 2), np.float32),
        np.zeros(2, np.float64),
        np.zeros(0, np.uint8),
    ]
    assert len({blob_hash(array) for array in zeros}) == len(zeros)


@settings(max_examples=20, deadline=None)
@given(batches(max_frames=3))
def test_the_same_run_gives_the_same_bytes(frames: list[list[c.Change]]) -> None:
    def log() -> list[str]:
        graph = SceneGraph()
        stamped = [s for i, batch in enumerate(frames) for s in graph.apply_all(batch, i, i / 5)]
        return [canonical_json(encode(change)[0]) for change in stamped] + [
            canonical_json(graph_to_json(graph))
        ]

    assert log() == log()


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda v: st.lists(v) | st.dictionaries(st.text(), v),
        max_leaves=8,
    )
)
def test_canonical_json_is_exact(value: object) -> None:
    text = canonical_json(json_value(value))
    assert json.loads(text) == value
    assert canonical_json(json.loads(text)) == text


BROKEN_ROWS = {
    "kind": ({"kind": "object_painted"}, "object_painted"),
    "missing field": ({"label": ...}, "no \\['label'\\]"),
    "unknown field": ({"weight": 1}, "unknown \\['weight'\\]"),
    "blob that is missing": ({"points": {"blob": "0" * 16, "dtype": "<f4", "shape": [1, 3]}}, "is missing"),
    "score text": ({"score": "high"}, "score"),
    "cause": ({"cause": {}}, "plugin"),
}


@pytest.mark.parametrize(("mutation", "says"), BROKEN_ROWS.values(), ids=BROKEN_ROWS.keys())
def test_a_malformed_row_is_refused(mutation: dict, says: str) -> None:
    row, blobs = encode(an_addition())
    broken = {key: value for key, value in {**row, **mutation}.items() if value is not ...}
    with pytest.raises(InputError, match=says):
        decode(broken, blobs)


def test_a_damaged_blob_is_refused() -> None:
    row, blobs = encode(an_addition())
    name = row["points"]["blob"]
    blobs[name] = bytes([blobs[name][0] ^ 1]) + blobs[name][1:]
    with pytest.raises(InputError, match=f"{name} is damaged"):
        decode(row, blobs)
    blobs[name] = blobs[name][:-4]
    with pytest.raises(InputError, match="change row 17"):
        decode(row, blobs)


# -- whole graphs -------------------------------------------------------------------------------------


def furnished() -> SceneGraph:
    """Two objects, two waypoints with a viewpoint each, a former place, every kind of edge."""
    graph = SceneGraph()
    common = {"cause": CAUSE, "score": 0.5, "range_m": 1.0}
    changes: list[c.Change] = []
    for n in (1, 2):
        matrix = np.eye(4)
        matrix[:3, 3] = n, 0.0, 0.88
        changes += [
            c.WaypointAdded(cause=CAUSE, waypoint_id=f"waypoint-{n}", position=np.array([n, 0.5, 0.0])),
            c.ViewpointAdded(
                cause=CAUSE,
                viewpoint_id=f"viewpoint-{n}.1",
                waypoint_id=f"waypoint-{n}",
                world_from_camera=matrix,
                heading=0.1,
                tilt=0.0,
            ),
            c.ObjectAdded(
                object_id=f"object-{n}",
                label=("chair", "table & co")[n - 1],
                viewpoint_id=f"viewpoint-{n}.1",
                text_feature=unit(n),
                **cloud(n, 20, (n, 1.0, 0.5)),
                **common,
            ),
        ]
    path = {"length": 1.0, "verified": "driven", "blocked": False}
    near = {"distance": 0.3, "relation": "next to", "offset": [1.0, 0.0, 0.0]}
    edges = [
        ("path", "waypoint-1", "waypoint-2", path),
        ("near", "object-1", "object-2", near),
        ("sees", "viewpoint-1.1", "object-1", {"distance": 1.0}),
        ("sees", "viewpoint-1.1", "object-2", {"distance": 2.0}),
        ("sees", "viewpoint-2.1", "object-2", {"distance": 0.5}),
    ]
    changes += [c.EdgeAdded(cause=CAUSE, edge=k, source=s, target=t, attributes=a) for k, s, t, a in edges]
    changes.append(
        c.ObjectReplaced(
            cause=CAUSE, object_id="object-1", history_id="history-1", **cloud(7, 20, (1.0, 1.5, 0.5))
        )
    )
    graph.apply_all(changes, 2, 0.4)
    return graph


def test_a_graph_that_is_not_one_is_refused() -> None:
    document = graph_to_json(furnished())
    with pytest.raises(InputError, match="version 1"):
        graph_from_json({**document, "version": 2})
    with pytest.raises(InputError, match="format"):
        graph_from_json({})
    for table, index, field, value in (
        ("objects", 1, "points", {"base64": "AAA"}),
        ("viewpoints", 0, "world_from_camera", [[1.0]]),
        ("edges", 3, "color", "red"),
    ):
        broken = json.loads(json.dumps(document))
        broken[table][index][field] = value
        with pytest.raises(InputError, match=rf"{table}\[{index}\]"):
            graph_from_json(broken)


def test_exports_are_deterministic_and_an_unknown_format_is_refused() -> None:
    for name in FORMATS:
        assert export_graph(furnished(), name) == export_graph(furnished(), name)
        assert export_graph(SceneGraph(), name)
    with pytest.raises(ConfigError, match=r"json, graphml, ply, spark-dsg, got 'stl'"):
        export_graph(furnished(), "stl")


def test_graphml_holds_every_node_and_edge() -> None:
    networkx = pytest.importorskip("networkx")
    graph = furnished()
    read = networkx.parse_graphml(export_graph(graph, "graphml").decode())
    kinds = {data["kind"] for _, data in read.nodes(data=True)}
    assert kinds == {"object", "history", "waypoint", "viewpoint"}
    assert len(read) == 2 + 1 + 2 + 2
    assert read.nodes["object-2"]["label"] == "table & co"
    assert read.nodes["object-2"]["box_0"] == float(graph.objects["object-2"].box_min[0])
    assert {(a, b) for a, b, kind in read.edges(data="kind") if kind != "has"} == {
        (edge.source, edge.target) for edge in graph.edges.values()
    }
    assert read.edges["waypoint-1", "waypoint-2"]["blocked"] is False


def test_ply_holds_every_point_with_its_colour_and_object() -> None:
    trimesh = pytest.importorskip("trimesh")
    graph = furnished()
    data = export_graph(graph, "ply")
    header, _, body = data.partition(b"end_header\n")
    assert b"comment object-2 tentative static table & co\n" in header
    clouds = [node.points for node in graph.objects.values()]
    assert len(body) == sum(len(points) for points in clouds) * (3 * 4 + 3 + 4)
    read = trimesh.load(trimesh.util.wrap_as_stream(data), file_type="ply")
    np.testing.assert_array_equal(read.vertices.astype(np.float32), np.concatenate(clouds))
    colors = np.concatenate([node.colors for node in graph.objects.values()])
    np.testing.assert_array_equal(np.asarray(read.colors)[:, :3], colors)


def test_spark_dsg_loads_the_export(tmp_path) -> None:  # type: ignore[no-untyped-def]
    spark_dsg = pytest.importorskip("spark_dsg")
    graph = furnished()
    file = tmp_path / "graph.json"
    file.write_bytes(export_graph(graph, "spark-dsg"))
    loaded = spark_dsg.DynamicSceneGraph.load(str(file))

    objects, places = (
        loaded.get_layer(layer) for layer in (spark_dsg.DsgLayers.OBJECTS, spark_dsg.DsgLayers.PLACES)
    )
    assert (objects.num_nodes(), places.num_nodes()) == (2, 2)
    names = loaded.get_labelspace(2, 0).labels_to_names
    for node in graph.objects.values():
        attributes = loaded.get_node(symbol(node.id)).attributes
        np.testing.assert_allclose(attributes.position, node.center)
        np.testing.assert_allclose(attributes.bounding_box.min, node.box_min, atol=1e-6)
        np.testing.assert_allclose(attributes.bounding_box.max, node.box_max, atol=1e-6)
        np.testing.assert_allclose(attributes.semantic_feature.ravel(), node.text_feature)
        assert attributes.name == node.label == names[attributes.semantic_label]
        assert attributes.metadata.get()["id"] == node.id
    for place in graph.waypoints.values():
        np.testing.assert_allclose(loaded.get_node(symbol(place.id)).attributes.position, place.position)
    found = {frozenset((edge.source, edge.target)) for edge in loaded.edges}
    expected = [
        ("object-1", "object-2"),
        ("waypoint-1", "waypoint-2"),
        ("waypoint-1", "object-1"),
        ("waypoint-1", "object-2"),
        ("waypoint-2", "object-2"),
    ]
    assert found == {frozenset(map(symbol, ends)) for ends in expected}
    assert loaded.get_edge(symbol("waypoint-2"), symbol("object-2")).info.weight == 0.5
