"""Objects of scene files in a scene: geometries, instances, names, and the messages about what cannot be loaded."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import MeshError, SceneError
from clbvh.geometry import Mesh, Spheres
from clbvh.rendering.scene_file import read_scene_file
from clbvh.scene.scene import Scene
from clbvh.scene.transforms import Transform


@pytest.fixture
def read(tmp_path):
    def read_text(text: str) -> Scene:
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return read_scene_file(path)[0]

    return read_text


BALL = '[[object]]\nlabel = "ball"\nshape = "icosphere"\ntriangles = 80\n'


def test_objects_become_geometries_and_instances(read, tmp_path):
    np.savez(tmp_path / "atoms.npz", centres=[[0, 0, 0], [1, 2, 3]], radii=[1, 0.5])
    (tmp_path / "points.csv").write_text("1,2,3\n")
    (tmp_path / "part.obj").write_text("o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\no b\nf 3 2 1\n")
    scene = read(
        BALL + "translate = [0, 5, 0]\nmask = 6\ncolour = [0.1, 0.2, 0.3]\n"
        '[[object]]\nspheres = "atoms.npz"\n'
        '[[object]]\nspheres = "points.csv"\nradii = 0.25\n'
        "[[object]]\ncentres = [[0, 0, 0], [4, 0, 0]]\nradii = 2\n"
        '[[object]]\npath = "part.obj"\n'
    )
    assert [geometry.name for geometry in scene.geometries] == ["ball", "atoms", "points", "spheres", "part"]
    assert [instance.name for instance in scene.instances] == ["ball", "atoms", "points", "spheres", "part"]
    ball, atoms, points, spheres, part = (geometry.shape for geometry in scene.geometries)
    assert isinstance(ball, Mesh)
    assert isinstance(atoms, Spheres)
    assert (atoms.radii == [1, 0.5]).all()
    assert (points.centres == [[1, 2, 3]]).all()
    assert points.radii == [0.25]
    assert (spheres.radii == [2, 2]).all()
    # A file of several parts is one mesh in a scene file.
    assert part.face_count == 2
    assert (scene.instances[0].transform == Transform(translate=(0, 5, 0)).matrix).all()
    assert [instance.mask for instance in scene.instances[:2]] == [6, 2**32 - 1]
    assert [instance.colour for instance in scene.instances[:2]] == [(0.1, 0.2, 0.3), None]


def test_objects_of_one_source_share_a_geometry(read):
    other = BALL.replace('"ball"', '"egg"')
    scene = read(BALL + other + "scale = [1, 2, 1]\n" + other.replace("egg", "dot").replace("80", "20"))
    assert [geometry.name for geometry in scene.geometries] == ["ball", "dot"]
    assert [(instance.name, instance.geometry.id) for instance in scene.instances] == [
        ("ball", 0), ("egg", 0), ("dot", 1),
    ]  # fmt: skip


def test_copies_are_named_after_their_object(read):
    scene = read(
        BALL + "repeat = {grid = [3, 1, 1], spacing = [5, 0, 0]}\n" + BALL.replace('"ball"', '"ball 2"') + "scale = 2"
    )
    assert [instance.name for instance in scene.instances] == ["ball", "ball 3", "ball 4", "ball 2"]
    assert [instance.transform[0, 3] for instance in scene.instances] == [-5, 0, 5, 0]


@pytest.mark.parametrize("mirror", [1, -1])
def test_copies_stand_on_the_surface_as_it_is_placed(read, mirror):
    scene = read(
        f'[[object]]\nlabel = "floor"\nshape = "terrain"\ntriangles = 2\nheight = 0\nscale = [{mirror}, 1, 0.5]\n'
        'translate = [0, 7, 0]\n[[object]]\nshape = "icosphere"\ntriangles = 20\n'
        'repeat = {on = "floor", count = 200, align = "normal", turn = false}'
    )
    transforms = np.array([instance.transform for instance in scene.instances[1:]])
    assert np.allclose(transforms[:, 1, 3], 7)
    assert np.abs(transforms[:, 0, 3]).max() == pytest.approx(5, abs=0.2)
    assert np.abs(transforms[:, 2, 3]).max() == pytest.approx(2.5, abs=0.1)
    # The normals of a mirrored floor still point up.
    assert np.allclose(transforms[:, :3, :3], np.eye(3))


def test_up_is_that_of_the_view(read):
    text = (
        '[[object]]\nlabel = "floor"\nshape = "terrain"\ntriangles = 2\nheight = 0\nrotate = [90, 0, 0]\n'
        '[[object]]\nshape = "icosphere"\ntriangles = 20\nrepeat = {on = "floor", count = 20}\n'
    )
    for up in ((0, 0, 1), (0, 1, 0)):
        scene = read(text + f"[view]\nup = {list(up)}")
        for instance in scene.instances[1:]:
            assert np.allclose(instance.transform[:3, :3] @ up, up)
            assert instance.transform[2, 3] == pytest.approx(0)
    assert (scene.snapshot().transforms == read(text).snapshot().transforms).all()  # y where it is to be guessed
    with pytest.raises(SceneError, match="'icosphere': up must not be zero"):
        read(text + "[view]\nup = [0, 0, 0]")


@pytest.mark.parametrize("seed", [3])
def test_the_same_seed_places_the_same_bytes(read, seed):
    text = BALL + f'[[object]]\nshape = "knot"\ntriangles = 200\nrepeat = {{on = "ball", count = 50, seed = {seed}}}'
    first, second = (read(text).snapshot().transforms for _ in range(2))
    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (BALL.replace("80", "3"), SceneError, r"scene\.toml: the object 'ball': .* at least 20 triangles"),
        (BALL + "matrix = [[1,0,0,0],[0,1,0,0],[0,0,0,0],[0,0,0,1]]", SceneError, "'ball': .*transform.* is singular"),
        (BALL + "matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,1]]", SceneError, "'ball': .* must be affine"),
        (BALL + "repeat = {grid = [9,1,1], spacing = [1e308,1,1]}", SceneError, "'ball': .* has -?inf in row 0"),
        ('[[object]]\npath = "gone.ply"', MeshError, r"the object 'gone': .*gone\.ply: no such file"),
        ('[[object]]\nspheres = "gone.csv"', MeshError, r"the object 'gone': .*gone\.csv: no such file"),
        ('[[object]]\nspheres = "galaxy"\narms = 0', SceneError, "the object 'galaxy': the option 'arms'"),
        ("[[object]]\ncentres = [[0, 0, 0]]\nradii = -1", MeshError, "the object 'spheres': .* has the radius -1"),
        ('[[object]]\nspheres = "a.csv"', SceneError, r"a\.csv: the file has no radii: give 'radii'"),
        ('[[object]]\nspheres = "b.csv"\nradii = 1', SceneError, r"b\.csv: the file has its own radii: leave"),
        (
            '[[object]]\nlabel = "line"\npath = "line.obj"\n' + BALL + 'repeat = {on = "line", count = 3}',
            MeshError,
            "the object 'ball': line: nothing can be scattered on a surface without area",
        ),
        (
            BALL + 'scale = 1e308\ntranslate = [1.5e308, 0, 0]\n[[object]]\nshape = "knot"\ntriangles = 200\n'
            'repeat = {on = "ball", count = 3}',
            MeshError,
            "the surface of 'ball' has coordinates that are not finite",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_loaded_is_named_with_its_object(read, tmp_path, text, error, message):
    (tmp_path / "a.csv").write_text("1,2,3\n")
    (tmp_path / "b.csv").write_text("1,2,3,4\n")
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(error, match=message) as caught:
        read(text)
    assert "\n" not in str(caught.value)
