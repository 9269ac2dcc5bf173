"""Mesh files as scenes: one or several, with parts or without, and saved scenes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from clbvh import Scene, View, load_mesh, make_shape, open_scene, save_scene
from clbvh.errors import MeshError, SceneError
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.open_scene import as_scene
from clbvh.rendering.view_finder import guess_up

from ..geometry.gltf_files import Gltf

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
ONE, TWO = f"{TRIANGLE}f 1 2 3\n", f"o a\n{TRIANGLE}f 1 2 3\no b\nf 3 2 1\n"


@pytest.fixture
def write(tmp_path):
    def write_file(name: str, content: bytes | str):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_file


def test_a_file_is_one_mesh_with_parts(write):
    scene, _ = open_scene(write("a.obj", TWO))
    assert [instance.name for instance in scene.instances] == ["a"]
    assert [part.name for part in scene.geometries[0].shape.parts] == ["a", "b"]


@pytest.mark.parametrize(("copies", "instances"), [(1, ["glb"]), (2, ["glb"]), (3, ["n", "n 2", "n 3"])])
def test_nodes_that_multiply_the_triangles_are_instances(tmp_path, copies, instances):
    gltf = Gltf()
    mesh = gltf.add_mesh({"attributes": {"POSITION": gltf.add_accessor(np.eye(3), "f4")}})
    for number in range(copies):
        gltf.add_node(mesh=mesh, name="n", translation=[number, 0, 0])
    path = gltf.write_glb(tmp_path / "glb.glb")
    for scene in (Scene(path), open_scene(path)[0], as_scene([path, path])[0]):
        assert [instance.name for instance in scene.instances][: len(instances)] == instances
    assert [part.name for part in load_mesh(path).parts] == (["n"] * copies if copies > 1 else [])


@pytest.mark.parametrize(("copies", "geometries"), [(2, ["Scene"]), (3, ["ball"])])
def test_nodes_of_trimesh_follow_the_same_rule(copies, geometries):
    source = trimesh.Scene()
    source.add_geometry(trimesh.creation.icosphere(1), geom_name="ball")
    for number in range(1, copies):
        source.graph.update(f"copy {number}", geometry="ball", matrix=np.diag([number + 1, 1, 1, 1]))
    scene = Scene(source)
    assert [geometry.name for geometry in scene.geometries] == geometries
    assert len(scene.instances) == (1 if geometries == ["Scene"] else copies)


@pytest.mark.parametrize("copies", [1, 3])
def test_gltf_files_have_y_up(tmp_path, copies):
    """A plate that lies in x and y, which would lie on the ground otherwise."""
    gltf = Gltf()
    corners = [[0, 0, 0], [5, 0, 0], [0, 5, 0.1]]
    mesh = gltf.add_mesh({"attributes": {"POSITION": gltf.add_accessor(corners, "f4")}})
    for number in range(copies):
        gltf.add_node(mesh=mesh, name="n", translation=[5 * number, 0, 0])
    state = Scene(gltf.write_glb(tmp_path / "plate.glb")).snapshot()
    assert guess_up(SceneBounds(state.shapes, state.geometry_ids, state.transforms)).vector == (0, 1, 0)


def test_several_files_are_placed_as_they_are(write):
    paths = [write("one.obj", ONE.replace("v 1", "v 5")), write("two.obj", TWO), write("one.obj", ONE)]
    scene, _ = as_scene([str(path) for path in paths])
    assert [instance.name for instance in scene.instances] == ["one", "two", "one 2"]
    for instance in scene.instances:
        assert (instance.transform == np.eye(4)).all()
    assert len(scene.find_geometry("two").shape.parts) == 2


def test_a_saved_scene_is_opened(tmp_path):
    scene = Scene()
    scene.place(scene.add(make_shape("icosphere", triangles=20)), name="ball")
    save_scene(tmp_path / "saved", scene, View(fov=20))
    opened, view = open_scene(tmp_path / "saved")
    assert ([instance.name for instance in opened.instances], view.fov) == (["ball"], 20)


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        (["a.obj", "b.toml"], SceneError, r"b\.toml: several files make a scene if all of them are meshes"),
        (["a.obj", "gone.ply"], MeshError, r"gone\.ply: no such file"),
    ],
)
def test_files_that_make_no_scene_are_refused(write, tmp_path, names, error, message):
    write("a.obj", ONE)
    write("b.toml", '[[object]]\nshape = "knot"')
    with pytest.raises(error, match=message):
        as_scene([tmp_path / name for name in names])


def test_a_shipped_scene_is_no_mesh_among_others(write):
    with pytest.raises(SceneError, match=r"^knot: several files make a scene if all"):
        as_scene([write("a.obj", ONE), "knot"])


@pytest.mark.parametrize(("suffixes", "up"), [(("stl", "STL"), (0, 0, 1)), (("stl", "obj"), (0, 1, 0))], ids=str)
def test_several_files_of_one_format_have_its_habit(tmp_path, suffixes, up):
    ball = trimesh.creation.icosphere(1)
    paths = [tmp_path / f"{name}.{suffix}" for name, suffix in zip("ab", suffixes, strict=True)]
    for path in paths:
        ball.export(path)
    scene, _ = as_scene(paths)
    assert [geometry.name for geometry in scene.geometries] == ["a", "b"]
    state = scene.snapshot()
    extent = SceneBounds(state.shapes, state.geometry_ids, state.transforms)
    assert guess_up(extent).vector == up
