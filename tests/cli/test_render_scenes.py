"""`clbvh render` of several meshes and of scenes: hits with ids and names, tables, refusals."""

from __future__ import annotations

import json

import imageio.v3 as imageio
import numpy as np
import pytest
import trimesh

from clbvh import open_scene

from .command import refuses, run_clbvh

SIZE = ("--width", 48, "--height", 36)

SCENE = """
[view]
up = "y"

[[object]]
label = "floor"
shape = "terrain"
triangles = 50
height = 0.2
colour = [0.1, 0.4, 0.1]

[[object]]
label = "tree"
shape = "icosphere"
triangles = 20
scale = 0.4
repeat = {on = "floor", count = 8, seed = 1}

[[object]]
label = "stars"
centres = [[0, 2, 0], [1, 2, 0]]
radii = 0.4
colour = [0.8, 0.1, 0.1]
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def meshes(tmp_path):
    """A ball, a cart of three parts, and two named boxes side by side."""
    trimesh.creation.icosphere(2, 0.5).export(tmp_path / "ball.ply")
    cart = trimesh.Scene()
    cart.add_geometry(trimesh.creation.box((2, 0.5, 1)), node_name="body", geom_name="box")
    wheel = trimesh.creation.icosphere(1, 0.3)
    for name, x in (("left", -1.0), ("right", 1.0)):
        matrix = trimesh.transformations.translation_matrix((x, -0.4, 0.6))
        cart.add_geometry(wheel, node_name=name, geom_name="wheel", transform=matrix)
    (tmp_path / "cart.glb").write_bytes(cart.export(file_type="glb"))
    (tmp_path / "steps.obj").write_text(
        "o low\nv 2 0 0\nv 3 0 0\nv 2 1 0\nf 1 2 3\no high\nv 2 1 1\nv 3 1 1\nv 2 2 1\nf 4 5 6\n"
    )
    return [tmp_path / name for name in ("ball.ply", "cart.glb", "steps.obj")]


def render(*arguments, folder):
    """Return the report of a picture and its hits file."""
    hits = folder / "hits.npz"
    result = run_clbvh("render", *arguments, "-o", folder / "out.ppm", "--hits", hits, "--json", "--up", "0,1,0", *SIZE)
    assert (result.returncode, result.stderr) == (0, "")
    with np.load(hits) as arrays:
        return json.loads(result.stdout), dict(arrays)


def test_several_meshes_are_drawn_together(meshes, tmp_path):
    report, hits = render(*meshes, folder=tmp_path)
    assert hits["instance_names"].tolist() == ["ball", "cart", "steps"]
    assert (report["instances"], report["geometries"]) == (3, 3)
    parts = hits["part_names"].tolist()
    assert parts == ["body", "left", "right", "low", "high"]
    assert {"body", "right", "low", "high"} <= {parts[index] for index in np.unique(hits["part_id"]) if index >= 0}
    is_hit = hits["prim_id"] >= 0
    assert is_hit.sum() == report["hits"] > 0
    assert ((hits["instance_id"] >= 0) == is_hit).all()
    assert ((hits["geometry_id"] >= 0) == is_hit).all()


@pytest.mark.parametrize(("name", "parts"), [("cart.glb", ["body", "left", "right"]), ("steps.obj", ["low", "high"])])
def test_a_file_of_parts_is_one_mesh_that_names_them(meshes, tmp_path, name, parts):
    report, hits = render(tmp_path / name, folder=tmp_path)
    assert hits["part_names"].tolist() == parts
    assert ((hits["part_id"] >= 0) == (hits["prim_id"] >= 0)).all()
    assert "instances" not in report


def test_the_hits_of_one_mesh_have_ids_and_names_too(meshes, tmp_path):
    report, hits = render(meshes[0], folder=tmp_path)
    assert "instances" not in report
    assert hits["geometry_names"].tolist() == hits["instance_names"].tolist() == ["ball"]
    assert (hits["instance_id"] == np.minimum(hits["prim_id"], 0)).all()
    assert (hits["geometry_id"] == hits["instance_id"]).all()


def test_the_hits_of_a_scene_name_its_objects(scene, tmp_path):
    report, hits = render(scene, folder=tmp_path)
    assert hits["geometry_names"].tolist() == ["floor", "tree", "stars"]
    assert hits["instance_names"].tolist() == [
        "floor", "tree", *(f"tree {number}" for number in range(2, 9)), "stars",
    ]  # fmt: skip
    geometry_of = np.array([0] + 8 * [1] + [2])
    is_hit = hits["instance_id"] >= 0
    assert (hits["geometry_id"][is_hit] == geometry_of[hits["instance_id"][is_hit]]).all()
    assert set(np.unique(hits["geometry_id"])) == {-1, 0, 1, 2}
    assert (report["geometries"], report["instances"], report["spheres"]) == (3, 10, 2)
    assert report["timings_ms"]["total"] >= report["timings_ms"]["load"] > 0


def test_the_table_counts_the_objects(scene, tmp_path):
    result = run_clbvh("render", scene, "-o", tmp_path / "out.ppm", *SIZE)
    assert (result.returncode, result.stderr) == (0, "")
    floor = open_scene(scene)[0].geometries[0].shape.face_count
    for words in (
        f"10 instances of 3 geometries, {floor + 8 * 20 + 2:,} primitives placed",
        f"{floor + 20:,} triangles, 2 spheres",
        "of both levels",
        "load and place the objects",
    ):
        assert words in result.stdout


def test_options_override_a_scene_of_objects(scene, tmp_path):
    arguments = ("--eye", "0,9,0.1", "--look-at", "0,0,0", "--shading", "normal")
    report, hits = render(scene, *arguments, folder=tmp_path)
    assert (report["width"], report["height"]) == (48, 36)
    # From above, the stars are in the middle of the floor.
    assert hits["instance_id"][18, 24] == 9


def test_several_sources_must_be_meshes(meshes, scene, tmp_path):
    out = ("-o", tmp_path / "out.ppm")
    refuses(run_clbvh("render", meshes[0], scene, *out), 2, "scene.toml", "draw a scene file alone")
    refuses(run_clbvh("render", meshes[0], tmp_path / "gone.ply", *out), 2, "gone.ply: no such file")
    assert not (tmp_path / "out.ppm").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colr = 1", ("object 1", "'colr'")),
        ("repeat = {grid = [2000, 2000, 1], spacing = [1, 1, 1]}", ("4,000,000 copies are too many",)),
        ("scale = [1, 0, 1]", ("object 1", "scale")),
        ("matrix = [[1,0,0,0],[0,0,0,0],[0,0,1,0],[0,0,0,1]]", ("the object 'knot'", "singular")),
    ],
)
@pytest.mark.parametrize("verb", ["render", "stats"])
def test_a_wrong_object_is_a_wrong_file(tmp_path, verb, text, words):
    path = tmp_path / "scene.toml"
    path.write_text(
        f'[[object]]\nshape = "knot"\n{text}\n' if "colr" not in text else f'[[object]]\nname = "b"\n{text}'
    )
    output = ("-o", tmp_path / "out.ppm") if verb == "render" else ()
    refuses(run_clbvh(verb, path, *output), 2, "scene.toml", *words)


def test_a_scene_is_validated(scene, tmp_path):
    result = run_clbvh("render", scene, "-o", tmp_path / "out.ppm", "--validate", *SIZE)
    assert (result.returncode, result.stderr) == (0, "")
    assert f"all trees and {48 * 36:,} pixels agree with the reference" in result.stdout


def test_the_trees_of_a_scene_are_kept(scene, tmp_path):
    arguments = ("--cache-dir", tmp_path / "trees")
    first, second = (render(scene, *arguments, folder=tmp_path)[0] for _ in range(2))
    assert (first["tree_from_cache"], second["tree_from_cache"]) == (False, True)
    assert len(list((tmp_path / "trees").iterdir())) == 3


def test_no_tree_at_all_gives_the_same_picture(scene, tmp_path):
    for builder in ("sah", "brute"):
        command = ("render", scene, "-o", tmp_path / f"{builder}.ppm", "--builder", builder, *SIZE)
        assert run_clbvh(*command).returncode == 0
    assert (tmp_path / "sah.ppm").read_bytes() == (tmp_path / "brute.ppm").read_bytes()


@pytest.mark.parametrize("quantity", ["nodes", "triangles"])
def test_a_heat_map_of_several_objects(scene, tmp_path, quantity):
    command = ("render", scene, "-o", tmp_path / "out.png", "--heatmap", quantity, *SIZE)
    assert run_clbvh(*command).returncode == 0
    picture = imageio.imread(tmp_path / "out.png")
    assert picture.shape[0] > 36
    assert len(np.unique(picture[:36].reshape(-1, 3), axis=0)) > 5
