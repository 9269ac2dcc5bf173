"""Which way is up: the rule of a format, what a mesh stands on, and the habit of its format."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.cameras.projection import read_up
from clbvh.rendering.view_finder import Y_UP, Z_UP, guess_up

CREATE = trimesh.creation
# From z up to y up.
TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


def as_mesh(solid):
    return clbvh.Mesh.from_arrays(solid.vertices, solid.faces)


def guess(mesh, kind=""):
    """Return the guess for a mesh that comes from a file of a kind."""
    return guess_up(SceneBounds.of_mesh(dataclasses.replace(mesh, name=f"a.{kind}")))


def turned(mesh):
    return mesh.with_vertices(mesh.vertices @ TURN.T)


def table():
    places = [(x, y, 0.5) for x in (-1, 1) for y in (-1, 1)]
    legs = [CREATE.box((0.1, 0.1, 1)).apply_translation(place) for place in places]
    return trimesh.util.concatenate([*legs, CREATE.box((2.4, 2.4, 0.1)).apply_translation((0, 0, 1))])


STANDING = {
    "cone": CREATE.cone(1, 2),
    "cylinder": CREATE.cylinder(1, 2),
    "ring": CREATE.torus(1, 0.3),
    "plate": CREATE.box((3, 2, 0.1)),
    "table": table(),
}


@pytest.mark.parametrize("name", STANDING)
@pytest.mark.parametrize("unit", [1e-30, 1, 1e30])
def test_a_mesh_stands_on_its_base_either_way(name, unit):
    mesh = as_mesh(STANDING[name])
    mesh = mesh.with_vertices(mesh.vertices * unit)
    assert guess(mesh, "obj").vector == Z_UP
    assert guess(turned(mesh), "stl").vector == Y_UP


HABITS = {"stl": Z_UP, "STL": Z_UP, "off": Z_UP, "obj": Y_UP, "ply": Y_UP, "": Y_UP}


@pytest.mark.parametrize(("kind", "up"), HABITS.items())
def test_the_habit_of_the_format_decides_where_the_shape_does_not(kind, up):
    for solid in (CREATE.box(), CREATE.icosphere()):
        vector, note = guess(as_mesh(solid), kind)
        assert vector == up
        assert note is None if up == Y_UP else note.startswith("z is up: most ")


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_the_rule_of_gltf_comes_first(kind):
    assert guess(as_mesh(STANDING["cone"]), kind) == (Y_UP, None)


def test_a_stray_point_changes_nothing():
    mesh = as_mesh(CREATE.cone(1, 2, sections=2000))
    strays = len(mesh.vertices) + np.arange(3)
    strayed = clbvh.Mesh.from_arrays(np.vstack((mesh.vertices, [[0, 0, -90]] * 3)), np.vstack((mesh.faces, strays)))
    assert guess(strayed, "obj").vector == Z_UP


FLAT = {
    "triangle": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    "line": [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
    "point": [[5, 5, 5]] * 3,
}


@pytest.mark.parametrize("vertices", FLAT.values(), ids=FLAT)
def test_meshes_without_a_height_have_the_habit_of_their_format(vertices):
    mesh = clbvh.Mesh.from_arrays(vertices, [[0, 1, 2]])
    assert guess(mesh, "ply").vector == Y_UP
    assert guess(mesh, "stl").vector == Z_UP


@pytest.mark.parametrize("name", ["bun_zipper.ply", "dragon_871k.ply"])
def test_scans_that_stand_are_recognised_in_any_format(name):
    path = Path(os.environ.get("CLBVH_MESHES", ""), name)
    if not path.is_file():
        pytest.skip(f"CLBVH_MESHES has no {name}")
    mesh = clbvh.load_mesh(path)
    assert guess(mesh, "stl").vector == Y_UP
    standing = mesh.with_vertices(mesh.vertices @ TURN)
    assert guess(standing, "obj").vector == Z_UP


# Two of them are along z in STL files: what is long and has no end to stand on lies.
@pytest.mark.parametrize("sections", [3, 12])
def test_a_spindle_does_not_stand_on_its_end_by_a_habit(sections):
    spindle = trimesh.util.concatenate(
        [CREATE.cone(1, 4, sections=sections), CREATE.cone(1, 4, sections=sections).apply_scale((1, 1, -1))]
    ).apply_translation((0, 0, 7))
    spindle.vertices[:, 0] += 0.3 * np.abs(spindle.vertices[:, 2] - 7)  # bent: both tips are beside the middle
    vector, note = guess(as_mesh(spindle), "stl")
    assert vector == Y_UP
    assert note.startswith("y is up: the mesh is long along z, and would not stand on its end; --up 0,0,1")
    short = spindle.apply_scale((2.5, 2.5, 1))
    assert guess(as_mesh(short), "stl").vector == Z_UP


@pytest.mark.parametrize(("thickness", "up"), [(0.02, Y_UP), (0.05, Z_UP)])
def test_nothing_stands_on_an_edge(thickness, up):
    assert guess(as_mesh(CREATE.box((thickness, 0.4, 1))), "stl").vector == up


@pytest.mark.parametrize("seed", range(40))
def test_clouds_of_spheres_have_y_up(seed):
    spheres = clbvh.Spheres(np.random.default_rng([86, seed]).random((30, 3)), 0.05)
    assert guess_up(SceneBounds((spheres,), np.zeros(1, int), np.eye(4)[None])) == (Y_UP, None)


UPS = {
    "z": (0, 0, 1), "+Z": (0, 0, 1), "-y": (0, -1, 0), "X": (1, 0, 0), "0,2,1": (0, 2, 1), "auto": "auto",
    (0, 2, 1): (0, 2, 1),
}  # fmt: skip


@pytest.mark.parametrize(("value", "up"), UPS.items())
def test_up_may_be_the_name_of_an_axis(value, up):
    assert read_up(value) == clbvh.View(up=value).up == up


@pytest.mark.parametrize("value", ["", "zz", "--z", "-", "0,0", "0,0,nan", "AUTO", None, 3, (1, 2), (0, 0, np.inf)])
def test_up_is_nothing_else(value):
    with pytest.raises(clbvh.SceneError, match="up must be a direction, an axis such as"):
        clbvh.View(up=value)


def test_what_users_say_of_cameras_needs_no_numpy():
    code = "import sys, clbvh.rendering.cameras.projection; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
