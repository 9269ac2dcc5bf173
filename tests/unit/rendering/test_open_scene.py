"""Scenes of mesh files, one or several, and the shipped scenes."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import MeshError, Scene, SceneError, load_mesh, open_scene
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.open_scene import as_scene
from clbvh.rendering.scene_file import parse_scene_file
from clbvh.rendering.view_finder import guess_up
from clbvh.support.folders import find_folder

from ..geometry.gltf_files import Gltf

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
ONE, TWO = f"{TRIANGLE}f 1 2 3\n", f"o a\n{TRIANGLE}f 1 2 3\no b\nf 3 2 1\n"
SHIPPED = (
    "bunny", "cornell", "demo", "dragon", "drill", "galaxy", "hall", "knot", "meadow", "palace", "still-life",
    "terrain", "weekend",
)  # fmt: skip


def up_of(scene):
    state = scene.snapshot()
    return guess_up(SceneBounds(state.shapes, state.geometry_ids, state.transforms)).vector


def names_of(scene):
    return [instance.name for instance in scene.instances]


@pytest.mark.parametrize(("copies", "instances"), [(1, ["glb"]), (2, ["glb"]), (3, ["n", "n 2", "n 3"])])
def test_nodes_that_multiply_the_triangles_are_instances(tmp_path, copies, instances):
    gltf = Gltf()
    # A plate that would lie on the ground if z were up; the rule of glTF is y.
    mesh = gltf.add_mesh({"attributes": {"POSITION": gltf.add_accessor([[0, 0, 0], [5, 0, 0], [0, 5, 0.1]], "f4")}})
    for number in range(copies):
        gltf.add_node(mesh=mesh, name="n", translation=[5 * number, 0, 0])
    path = gltf.write_glb(tmp_path / "glb.glb")
    for scene in (Scene(path), open_scene(path)[0], as_scene([path, path])[0]):
        assert names_of(scene)[: len(instances)] == instances
        assert up_of(scene) == (0, 1, 0)
    assert [part.name for part in load_mesh(path).parts] == (["n"] * copies if copies > 1 else [])


def test_several_files_are_placed_as_they_are(tmp_path):
    for name, text in (("one", ONE), ("two", TWO)):
        (tmp_path / f"{name}.obj").write_text(text)
    scene, _ = as_scene([str(tmp_path / f"{name}.obj") for name in ("one", "two", "one")])
    assert names_of(scene) == ["one", "two", "one 2"]
    assert all((instance.transform == np.eye(4)).all() for instance in scene.instances)
    assert [part.name for part in scene.find_geometry("two").shape.parts] == ["a", "b"]
    (tmp_path / "b.toml").write_text('[[object]]\nshape = "knot"')
    rows = [(tmp_path / "b.toml", SceneError), ("knot", SceneError), (tmp_path / "gone.ply", MeshError)]
    for other, error in rows:
        with pytest.raises(error, match=rf"{other}: (no such file|several files make a scene if all)"):
            as_scene([tmp_path / "one.obj", other])


def test_the_shipped_scenes_are_the_promised_ones_and_say_what_is_up(tmp_path, monkeypatch):
    paths = sorted(find_folder("scenes").glob("*.toml"))
    assert [path.stem for path in paths] == sorted(SHIPPED)
    assert all(parse_scene_file(path).view.up != "auto" for path in paths)
    with pytest.raises(SceneError, match=r"bunni: no such file, and no shipped scene: these are bunny, cornell, demo"):
        open_scene("bunni")
    # A file comes before a shipped scene of its name.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "knot").write_text(ONE)
    assert open_scene("knot")[0].geometries[0].shape.face_count == 1


# By name: geometries, instances, and primitives of all geometries.
SIZES = {"meadow": (4, 10_001), "galaxy": (None, None, 200_000), "knot": (1, 1, 871_200), "weekend": (1, 1, 480)}


@pytest.mark.parametrize("name", ["meadow", "galaxy", "hall", "still-life", "cornell", "weekend", "knot"])
def test_a_shipped_scene_is_the_same_every_time(name):
    scenes = [open_scene(name)[0] for _ in range(2)]
    first, second = (scene.snapshot() for scene in scenes)
    assert first.transforms.tobytes() == second.transforms.tobytes()
    assert [shape.fingerprint for shape in first.shapes] == [shape.fingerprint for shape in second.shapes]
    counts = len(first.shapes), len(first.transforms), sum(shape.prim_count for shape in first.shapes)
    assert all(wanted in (None, count) for wanted, count in zip(SIZES.get(name, ()), counts, strict=False))
