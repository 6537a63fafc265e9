"""Furniture: the category table, both libraries, the OBJ reader and the mesh cache."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from dssmsg.errors import ConfigError, InputError
from dssmsg.sim.furniture import FurnitureLibrary
from dssmsg.sim.furniture.cache import MeshCache
from dssmsg.sim.furniture.catalogue import cache_key, convert, read_catalogue
from dssmsg.sim.furniture.categories import load_categories
from dssmsg.sim.furniture.embedded import build
from dssmsg.sim.furniture.library import SYSTEM_FOLDER
from dssmsg.sim.furniture.wavefront import read_obj, triangulate
from dssmsg.sim.mesh import Mesh, box, cylinder, merge, sphere

needs_real = pytest.mark.skipif(
    not list(SYSTEM_FOLDER.glob("*.sh3f")), reason="sweethome3d-furniture is not installed"
)

NEEDED = """sofa;armchair;chair;table;coffee table;desk;bed;wardrobe;bookcase;cabinet;sink;washbasin;
toilet;bathtub;shower;mirror;fridge;oven;dishwasher;washing machine;tv;tv stand;lamp;floor lamp;plant;
piano;mug;cup;bottle;laptop;book;vase;picture;rug;radiator;clock;stool;bench;trash can;basket;toaster;
microwave;phone;computer;monitor;guitar;cushion;curtain;box;shoes;bicycle;teddy bear;nightstand;
office chair;kettle;kitchen cabinet"""


@pytest.fixture
def embedded() -> FurnitureLibrary:
    return FurnitureLibrary.open("embedded")


def test_every_needed_category_exists(embedded: FurnitureLibrary) -> None:
    assert set(NEEDED.replace("\n", "").split(";")) <= set(embedded.categories())
    assert embedded.kind == "embedded"
    assert embedded.note


def test_embedded_pieces_fill_their_size_and_stand_on_the_origin(embedded: FurnitureLibrary) -> None:
    for category in embedded.categories():
        for name in embedded.models(category):
            piece = embedded.model(category, name)
            low, high = piece.mesh.bounds
            np.testing.assert_allclose(high - low, piece.size, atol=1e-5, err_msg=category)
            np.testing.assert_allclose([*(low + high)[:2], low[2]], 0, atol=1e-5, err_msg=category)
            assert len(np.unique(piece.mesh.face_colors, axis=0)) >= 1
            assert piece.credit is None
            assert all(0.001 < x < 4 for x in piece.size), category


def test_a_given_size_stretches_and_z_is_optional(embedded: FurnitureLibrary) -> None:
    table = embedded.model("table")
    wide = embedded.model("table", size=(2.0, 0.5))
    np.testing.assert_allclose(wide.mesh.size, [2.0, 0.5, table.size[2]], atol=1e-5)
    assert embedded.model("table", size=(1, 1, 1)).size == (1, 1, 1)
    assert embedded.model("Coffee_Table").category == "coffee table"


def test_models_of_a_category_differ_in_colour(embedded: FurnitureLibrary) -> None:
    first, second = embedded.models("sofa")[:2]
    one, two = embedded.model("sofa", first).mesh.face_colors, embedded.model("sofa", second).mesh.face_colors
    assert not np.array_equal(one, two)


def test_sofa_back_is_at_the_back(embedded: FurnitureLibrary) -> None:
    for category in ("sofa", "armchair", "chair", "bed"):
        mesh = embedded.model(category).mesh
        upper = mesh.vertices[mesh.vertices[:, 2] > 0.9 * mesh.size[2]]
        assert upper[:, 1].mean() > 0.2 * mesh.size[1], category


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda lib: lib.model("sofaa"), ("sofaa", "sofa")),
        (lambda lib: lib.model("sofa", "nope"), ("nope", "Scopia/beige_sofa")),
        (lambda lib: lib.model("sofa", size=(1, -1)), ("size", "metres")),
        (lambda lib: lib.model("sofa", size=(1, 2, 3, 4)), ("2 or 3",)),
        (lambda lib: FurnitureLibrary.open("fancy"), ("fancy", "embedded")),
    ],
)
def test_mistakes_name_what_would_be_accepted(embedded: FurnitureLibrary, call, words) -> None:
    with pytest.raises(ConfigError) as caught:
        call(embedded)
    assert all(word in str(caught.value) for word in words)


def test_real_assets_missing_is_an_error_and_auto_falls_back(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("DSSMSG_FURNITURE", str(tmp_path))
    with pytest.raises(ConfigError, match="sweethome3d-furniture"):
        FurnitureLibrary.open("real")
    library = FurnitureLibrary.open("auto")
    assert library.kind == "embedded"
    assert str(tmp_path) in library.note


def test_a_part_that_does_not_read_is_named() -> None:
    with pytest.raises(InputError, match=r"chair.*box 0 0"):
        build(["box 0 0"], (1, 1, 1), "ffffff", "chair")


OBJ = """mtllib m.mtl
v -50 0 -25
v 50 0 -25
v 50 200 -25
v -50 200 -25
v -50 0 25
v 50 0 25
v 50 200 25
v -50 200 25
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl front
f 5/1 6/2 7/3 8/4
usemtl back
f 1 4 3 2
usemtl missing
f -8 -7 -3 -4
usemtl nothing
f 1 2 3
"""
MTL = (
    "newmtl front\nKd 1 1 1\nmap_Kd tex.png\nnewmtl back\nKd 0 1 0\nmap_Kd absent.png\n"
    "newmtl nothing\nd 0\nKd 1 0 0\n"
)


def write_library(path: Path, obj: str = OBJ, rotation: str = "") -> Path:
    picture = np.zeros((4, 4, 3), np.uint8)
    picture[0] = 255  # the top row
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "png")
    with zipfile.ZipFile(path, "w") as content:
        content.writestr(
            "PluginFurnitureCatalog.properties",
            "license=Creative Commons Attribution 3.0 Unported license\n"
            "id#1=Test#thing\nname#1=Th\\u00EFng\ncreator#1=Somebody\nmodel#1=/t/thing/thing.obj\nwidth#1=100\n"
            f"depth#1=50\nheight#1=200\nelevation#1=10\n{rotation}\nid#2=Test#broken\nname#2=no size\n",
        )
        content.writestr("t/thing/thing.obj", obj)
        content.writestr("t/thing/m.mtl", MTL)
        content.writestr("t/thing/TEX.PNG", buffer.getvalue())
    return path


def test_sh3f_axes_units_materials_and_flaws(tmp_path: Path) -> None:
    entries = read_catalogue(write_library(tmp_path / "Lib.sh3f"))
    assert list(entries) == ["Lib/thing"]  # the row without a size is left out
    entry = entries["Lib/thing"]
    assert entry.size == (1.0, 0.5, 2.0)
    assert entry.elevation == 0.1
    assert entry.credit == "Th\u00efng by Somebody (Lib), CC BY 3.0"
    mesh = convert(entry)
    np.testing.assert_allclose(mesh.size, [1, 0.5, 2], atol=1e-6)
    textured = mesh.face_texture >= 0
    assert textured.sum() == 2
    front = mesh.vertices[mesh.faces[textured]]
    assert (front[..., 1] < 0).all()  # their +z is the front, ours is -y
    top = front[..., 2] > 1
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv[textured][..., 1], top)  # v grows upwards
    assert mesh.textures[0][0].mean() > 200  # row 0 is the top row
    assert [0, 255, 0] in mesh.face_colors.tolist()  # missing texture: the plain colour
    assert [178, 178, 178] in mesh.face_colors.tolist()  # missing material: grey
    assert [255, 0, 0] not in mesh.face_colors.tolist()  # invisible helper geometry
    assert len(mesh.faces) == 6


def test_damaged_texture_coordinates_fall_back_to_the_plain_colour(tmp_path: Path) -> None:
    damaged = OBJ.replace("vt 1 1", "vt 3e9 nan")
    mesh = convert(read_catalogue(write_library(tmp_path / "Lib.sh3f", damaged))["Lib/thing"])
    assert (mesh.face_texture < 0).all()
    assert len(mesh.faces) == 6
    plain = box((1, 1, 1), (9, 9, 9))
    uv = np.full((12, 3, 2), 1e7, np.float32)
    with pytest.raises(ValueError, match="uv"):
        Mesh(plain.vertices, plain.faces, plain.face_colors, uv, np.full(12, -1, np.int32))


def test_model_rotation_turns_the_model(tmp_path: Path) -> None:
    half_turn = "modelRotation#1=-1 0 0 0 1 0 0 0 -1"
    entry = read_catalogue(write_library(tmp_path / "Lib.sh3f", rotation=half_turn))["Lib/thing"]
    mesh = convert(entry)
    assert (mesh.vertices[mesh.faces[mesh.face_texture >= 0]][..., 1] > 0).all()


def test_cache_gives_the_same_mesh_and_survives_damage(tmp_path: Path) -> None:
    entry = read_catalogue(write_library(tmp_path / "Lib.sh3f"))["Lib/thing"]
    cache = MeshCache(tmp_path / "cache")
    key = cache_key(entry)
    assert cache.load(key) is None
    mesh = convert(entry)
    cache.store(key, mesh)
    again = cache.load(key)
    assert again is not None
    for name in ("vertices", "faces", "face_colors", "face_texture"):
        np.testing.assert_array_equal(getattr(mesh, name), getattr(again, name))
    textured = mesh.face_texture >= 0
    assert mesh.uv is not None
    assert again.uv is not None
    np.testing.assert_array_equal(mesh.uv[textured], again.uv[textured])
    np.testing.assert_array_equal(mesh.textures[0], again.textures[0])
    assert [p.suffix for p in cache.folder.iterdir()] == [".npz"]
    file = cache.folder / f"{key}.npz"
    file.write_bytes(file.read_bytes()[:300])
    assert cache.load(key) is None
    changed = read_catalogue(write_library(tmp_path / "Lib.sh3f", OBJ.replace("200", "210")))["Lib/thing"]
    assert cache_key(changed) != key


def test_a_cache_that_cannot_be_written_does_not_stop(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    cache = MeshCache(tmp_path / "file" / "below")
    cache.store("key", box((1, 1, 1), (1, 2, 3)))
    assert cache.load("key") is None


def test_a_file_that_is_no_library_is_named(tmp_path: Path) -> None:
    path = tmp_path / "bad.sh3f"
    path.write_text("no zip")
    with pytest.raises(InputError, match=r"bad\.sh3f"):
        read_catalogue(path)
    with pytest.raises(InputError, match=r"no face"):
        read_obj("x.obj", lambda path: b"v 0 0 0\n")


def test_concave_polygons_keep_their_area() -> None:
    outline = [(0, 0, 5), (4, 0, 5), (4, 4, 5), (2, 1, 5), (0, 4, 5)]  # an M: a fan would cover the notch
    triangles = triangulate(range(5), outline)
    points = np.array(outline, float)
    areas = [np.cross(points[b] - points[a], points[c] - points[a])[2] / 2 for a, b, c in triangles]
    assert min(areas) > 0
    assert sum(areas) == pytest.approx(10.0)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.3, 2.0), min_size=4, max_size=9),
    st.permutations([0, 1, 2]),
    st.sampled_from([1.0, -1.0]),
)
def test_star_polygons_are_covered_exactly(radii, axes, turn) -> None:
    angle = turn * np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    flat = np.column_stack([radii * np.cos(angle), radii * np.sin(angle), np.full(len(radii), 0.3)])
    points = flat[:, axes]
    after = np.roll(flat, -1, axis=0)
    shoelace = abs(float((flat[:, 0] * after[:, 1] - flat[:, 1] * after[:, 0]).sum())) / 2
    corners = points[np.array(triangulate(range(len(radii)), points.tolist()))]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert areas.sum() == pytest.approx(shoelace, rel=1e-6)


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(float) for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def test_primitives_are_closed_and_face_outwards() -> None:
    assert volume(box((1, 2, 3), (0, 0, 0))) == pytest.approx(6)
    assert volume(cylinder(0.5, 2, (0, 0, 0), segments=64)) == pytest.approx(np.pi / 2, rel=0.01)
    assert volume(sphere(1, (0, 0, 0), rings=40, segments=40)) == pytest.approx(4 / 3 * np.pi, rel=0.02)
    assert volume(box((1, 2, 3), (0, 0, 0)).transformed(np.diag([-1.0, 1, 1, 1]))) == pytest.approx(6)
    for shape in ("disc", "wheel", "cone", "cone2", "bowl"):
        assert volume(build([f"{shape} 0 0 0 1 1 1 ffffff"], (1, 1, 1), "ffffff", "x")) > 0.05, shape


def test_merge_shares_textures_and_keeps_flat_faces_flat() -> None:
    image = np.zeros((2, 2, 3), np.uint8)
    image.flags.writeable = False
    uv = np.zeros((12, 3, 2), np.float32)
    plain = box((1, 1, 1), (9, 9, 9))
    skinned = Mesh(plain.vertices, plain.faces, plain.face_colors, uv, np.zeros(12, np.int32), (image,))
    both = merge([plain, skinned, skinned])
    assert len(both.textures) == 1
    assert both.face_texture.tolist() == [-1] * 12 + [0] * 24
    with pytest.raises(ValueError, match="face_texture"):
        Mesh(plain.vertices, plain.faces, plain.face_colors, uv, np.ones(12, np.int32), (image,))


@needs_real
def test_the_table_agrees_with_the_installed_libraries() -> None:
    entries = {}
    for archive in sorted(SYSTEM_FOLDER.glob("*.sh3f")):
        entries |= read_catalogue(archive)
    assert len(entries) > 800
    for row in load_categories().values():
        for piece in row.pieces if row.real else ():
            np.testing.assert_allclose(entries[piece.model].size, piece.size, atol=1e-3, err_msg=piece.model)


@needs_real
def test_real_pieces_have_their_size_front_and_credit(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.delenv("DSSMSG_FURNITURE", raising=False)
    library = FurnitureLibrary.open("real", cache=MeshCache(tmp_path))
    chosen = [
        library.model(name) for name in ("chair", "table", "toilet", "bottle", "mirror", "shelf", "stool")
    ]
    for piece in chosen:
        np.testing.assert_allclose(piece.mesh.size, piece.size, atol=1e-3)
    chair, toilet = chosen[0].mesh, chosen[2].mesh
    for mesh in (chair, toilet):  # back rest and cistern are behind
        assert mesh.vertices[mesh.vertices[:, 2] > 0.9 * mesh.size[2]][:, 1].mean() > 0.15 * mesh.size[1]
    assert not library.flawed
    credits = library.credits(chosen)
    assert len(credits) == len(chosen) - 1  # mirrors are our own
    assert all("CC" in line for line in credits)
    cached = FurnitureLibrary.open("real", cache=MeshCache(tmp_path)).model("bottle").mesh
    np.testing.assert_array_equal(cached.vertices, chosen[3].mesh.vertices)
