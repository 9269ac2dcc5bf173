"""The values of a scene are checked when it is made."""

from __future__ import annotations

import pytest

import clbvh
from clbvh import Light, Scene
from clbvh.errors import MeshError, SceneError
from clbvh.rendering.open_scene import open_scene

BUNNY = MeshSource(name="bunny")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"eye": (1, 2)}, "the camera's eye must be three finite numbers"),
        ({"eye": ((1, 2), 3, 4)}, "the camera's eye must be three finite numbers"),
        ({"eye": (0, 0, 1), "look_at": "origin"}, "look_at must be three finite numbers"),
        ({"up": (0, float("nan"), 0)}, "up must be three finite numbers"),
        ({"fov": "wide"}, "fov must be above 0"),
        ({"surface": 0.5}, "the surface colour must be three"),
        ({"background": 0.5}, "a colour, or two"),
        ({"background": ((0, 0, 0), (1, 1))}, "a background colour must be three"),
        ({"width": 10.5}, "width must be 1 to 65535"),
        ({"height": "10"}, "height must be 1 to 65535"),
        ({"width": True}, "width must be 1 to 65535"),
        ({"shading": ["normal"]}, "shading must be one of"),
    ],
)
def test_a_value_that_cannot_be_drawn_is_refused(values, message):
    with pytest.raises(SceneError, match=message):
        Scene(BUNNY, **values)


@pytest.mark.parametrize("values", [{"colour": 1}, {"sky": (1, 1)}, {"direction": (0, 0, 0)}, {"direction": "up"}])
def test_a_light_that_cannot_shine_is_refused(values):
    with pytest.raises(SceneError, match="the light's"):
        Light(**values)


@pytest.mark.parametrize("values", [{}, {"name": "bunny", "shape": "knot"}])
def test_a_mesh_has_exactly_one_source(values):
    with pytest.raises(SceneError, match="exactly one of path, name and shape"):
        MeshSource(**values)


def test_something_that_names_no_scene_is_refused():
    with pytest.raises(SceneError, match="not 5"):
        open_scene(5)
    with pytest.raises(MeshError, match=r"a clbvh\.Scene, the path or name of one, .*, not NoneType"):
        clbvh.render(None)


def test_something_that_names_no_file_is_a_mesh_error():
    with pytest.raises(clbvh.errors.MeshError, match="not by 5"):
        clbvh.load_mesh(5)


def test_one_colour_is_both_of_the_background():
    assert Scene(MeshSource(name="bunny"), background=(1, 0.5, 0)).background == ((1, 0.5, 0), (1, 0.5, 0))


def test_a_mesh_of_any_form_is_a_source(tmp_path):
    triangle = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]
    mesh = clbvh.Mesh.from_arrays(*triangle)
    assert Scene(mesh).mesh == mesh
    assert Scene(mesh).mesh.load() is mesh
    assert Scene(triangle).mesh.load().face_count == 1
    # A file is read when it is needed.
    assert Scene(tmp_path / "part.stl").mesh == str(tmp_path / "part.stl")
    with pytest.raises(MeshError, match="not int 5"):
        Scene(5)
