"""Mesh files as scenes: one or several, with parts or without, and saved scenes."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from clbvh import Scene, make_shape
from clbvh.errors import MeshError, SceneError
from clbvh.geometry.loading.load import may_have_parts
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.guesses import guess_up
from clbvh.rendering.open_scene import open_mesh_file, open_mesh_files, open_scene

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


def make_glb(*nodes: dict) -> str:
    gltf = Gltf()
    for node in nodes:
        gltf.add_part(np.eye(3), [[0, 1, 2]], node=node)
    return json.dumps(gltf.document)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.obj", ONE, False),
        ("a.obj", "o a\n" + ONE, False),
        ("a.obj", "o a\n" + ONE + "o a\n", False),
        ("a.obj", TWO, True),
        ("a.OBJ", TWO.replace("\n", "\r\n"), True),
        ("a.obj", TWO.replace("o ", "g "), True),
        ("a.obj", "o a\n" + ONE.replace("v 0 0 0", "g x\nv 0 0 0") + "g y\n", False),  # the objects count
        ("a.obj", ONE + "o a\nf 1 2 3\n", True),  # faces above the first name
        ("a.obj", "g a\n" + ONE + "g b", True),
        ("a.obj", "", False),
        ("a.ply", TWO, False),
        ("a.glb", "glTF", False),
        ("a.gltf", "{}", False),
        ("a.gltf", "{[", False),
        ("a.gltf", '{"meshes": [{}, {}]}', True),
        ("a.gltf", '{"meshes": [{}]}', False),
        ("a.gltf", make_glb({}), False),
        ("a.gltf", make_glb({}, {}), True),
    ],
)
def test_a_look_at_a_file_finds_its_parts(write, name, content, expected):
    assert may_have_parts(write(name, content)) == expected


def test_a_file_that_is_not_there_has_no_parts(tmp_path):
    assert not may_have_parts(tmp_path / "gone.obj")
    assert not may_have_parts(tmp_path)


def test_a_mesh_is_loaded_later(write):
    path = write("a.obj", ONE)
    assert open_mesh_file(path).mesh == str(path)
    assert open_mesh_file("gone.obj").mesh == "gone.obj"


def test_parts_keep_their_names(write):
    for scene in (open_mesh_file(write("a.obj", TWO)), open_scene(write("a.obj", TWO))):
        assert scene.mesh is None
        assert [instance.name for instance in scene.instances] == ["a", "b"]


def test_names_without_faces_are_no_parts(write):
    path = write("a.obj", ONE + "g empty\n")
    assert may_have_parts(path)
    assert open_mesh_file(path).mesh == str(path)


def test_several_files_are_placed_as_they_are(write):
    scene = open_mesh_files([write("one.obj", ONE.replace("v 1", "v 5")), write("two.obj", TWO), write("one.obj", ONE)])
    assert [instance.name for instance in scene.instances] == ["one", "a", "b", "one 2"]
    for instance in scene.instances:
        assert (instance.transform == np.eye(4)).all()


def test_one_of_several_is_as_one(write):
    path = write("a.obj", ONE)
    assert open_mesh_files([path]) == open_mesh_file(path)


def test_a_saved_scene_is_opened(tmp_path):
    scene = Scene()
    view = View(fov=20)
    scene.place(scene.add(make_shape("icosphere", triangles=20)), name="ball")
    scene.save(tmp_path / "saved")
    opened = open_scene(tmp_path / "saved")
    assert ([instance.name for instance in opened.instances], opened.fov) == (["ball"], 20)


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        ([], SceneError, "at least one"),
        (["a.obj", "b.toml"], SceneError, r"b\.toml: several files make a scene if all of them are meshes"),
        (["a.obj", "gone.ply"], MeshError, r"gone\.ply: no such file"),
    ],
)
def test_files_that_make_no_scene_are_refused(write, tmp_path, names, error, message):
    write("a.obj", ONE)
    write("b.toml", '[[object]]\nshape = "knot"')
    with pytest.raises(error, match=message):
        open_mesh_files([tmp_path / name for name in names])


def test_a_shipped_scene_is_no_mesh_among_others(write):
    with pytest.raises(SceneError, match=r"^knot: several files make a scene if all"):
        open_mesh_files([write("a.obj", ONE), "knot"])


@pytest.mark.parametrize(("suffixes", "up"), [(("stl", "STL"), (0, 0, 1)), (("stl", "obj"), (0, 1, 0))], ids=str)
def test_several_files_of_one_format_have_its_habit(tmp_path, suffixes, up):
    ball = trimesh.creation.icosphere(1)
    paths = [tmp_path / f"{name}.{suffix}" for name, suffix in zip("ab", suffixes, strict=True)]
    for path in paths:
        ball.export(path)
    scene = open_mesh_files(paths)
    assert [geometry.name for geometry in scene.geometries] == ["a", "b"]
    state = scene.snapshot()
    extent = SceneBounds(state.shapes, state.geometry_ids, state.transforms)
    assert guess_up(extent).vector == up
