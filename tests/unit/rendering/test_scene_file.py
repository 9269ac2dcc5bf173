"""Scene files: their keys, and the messages about invalid ones."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import SceneError
from clbvh.geometry import Mesh, Spheres
from clbvh.rendering.cameras.projection import Fisheye, Orthographic, Panorama
from clbvh.rendering.open_scene import open_scene
from clbvh.rendering.scene import MeshSource, Scene
from clbvh.rendering.scene_file import read_scene
from clbvh.rendering.sources import Transform
from clbvh.support.folders import find_folder

SHIPPED = (
    "bunny", "cornell", "demo", "dragon", "drill", "galaxy", "hall", "knot", "meadow", "palace", "still-life",
    "terrain", "weekend",
)  # fmt: skip

WHOLE = """
[mesh]
shape = "knot"
triangles = 1000
seed = 3

[transform]
scale = 2
rotate = [0, 90, 0]
translate = [1, 2, 3.5]

[camera]
eye = [0, 0, 9]
look_at = [0, 1, 0]
up = [0, 1, 0.5]
fov = 40

[light]
direction = [1, 1, 0]
colour = [1, 1, 1]
sky = [0.1, 0.2, 0.3]
ground = [0, 0, 0]

[image]
width = 64
height = 32
shading = "lambert"
surface = [1, 0, 0]
background = [[0, 0, 0], [1, 1, 1]]
"""


@pytest.fixture
def read(tmp_path):
    def read_text(text: str) -> Scene:
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return read_scene(path)

    return read_text


@pytest.mark.parametrize(
    ("keys", "projection"),
    [
        ("", None),
        ('kind = "perspective"', None),
        ('kind = "orthographic"', Orthographic()),
        ('kind = "orthographic"\nheight = 3', Orthographic(3.0)),
        ('kind = "fisheye"', Fisheye(180)),
        ('kind = "fisheye"\nangle = 220.5', Fisheye(220.5)),
        ('kind = "panorama"', Panorama()),
    ],
)
def test_a_camera_has_the_projection_of_its_kind(read, keys, projection):
    assert read(f'[mesh]\nshape = "knot"\n[camera]\n{keys}\n').projection == projection


def test_a_camera_may_have_an_aperture(read):
    scene = read('[mesh]\nshape = "knot"\n[camera]\naperture = 0.1\nfocus_distance = 3\n')
    assert (scene.aperture, scene.focus_distance) == (0.1, 3)


def test_every_key_reaches_the_scene(read):
    scene = read(WHOLE)
    assert scene.mesh == MeshSource(shape="knot", triangles=1000, seed=3)
    assert scene.transform == Transform(2, (0, 90, 0), (1, 2, 3.5))
    assert (scene.eye, scene.look_at, scene.up, scene.fov) == ((0, 0, 9), (0, 1, 0), (0, 1, 0.5), 40)
    assert (scene.light.direction, scene.light.colour) == ((1, 1, 0), (1, 1, 1))
    assert (scene.light.sky, scene.light.ground) == ((0.1, 0.2, 0.3), (0, 0, 0))
    assert (scene.width, scene.height, scene.shading) == (64, 32, "lambert")
    assert (scene.surface, scene.background) == ((1, 0, 0), ((0, 0, 0), (1, 1, 1)))


def test_what_is_left_out_has_its_default(read):
    assert read('[mesh]\nname = "bunny"') == Scene(MeshSource(name="bunny"))


def test_a_mesh_path_counts_from_the_scene_file(read, tmp_path):
    assert read('[mesh]\npath = "sub/a.ply"').mesh.path == str(tmp_path / "sub/a.ply")


def test_one_background_colour_stands_for_both(read):
    assert read('[mesh]\nname = "b"\n[image]\nbackground = [0, 0.5, 1]').background == ((0, 0.5, 1), (0, 0.5, 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"no \[mesh\] table"),
        ("[mesh]\n", "exactly one of path, name and shape"),
        ('[mesh]\nname = "a"\npath = "b"', "exactly one"),
        ('[mesh]\nname = "a"\ncolour = 1', r"\[mesh\] has an unknown key 'colour'"),
        ('mesh = "a"', r"'mesh' must be a table"),
        ('[mesh]\nname = "a"\n[lights]', "unknown key 'lights'"),
        ("[mesh]\nname = 7", "name must be a text, not 7"),
        ('[mesh]\nname = "a"\n[camera]\neye = [1, 2]', "eye must be three finite numbers"),
        ('[mesh]\nname = "a"\n[camera]\neye = [1, 2, nan]', "eye must be three finite numbers"),
        ('[mesh]\nname = "a"\n[camera]\nlook_at = [0, 0, 0]', "needs an eye"),
        ('[mesh]\nname = "a"\n[camera]\nfov = 0', "fov"),
        ('[mesh]\nname = "a"\n[camera]\nkind = "pinhole"', "projection must be one of perspective, orthographic"),
        ('[mesh]\nname = "a"\n[camera]\nkind = 3', "kind must be a text"),
        ('[mesh]\nname = "a"\n[camera]\nkind = "fisheye"\nheight = 2', "kind fisheye has no height"),
        ('[mesh]\nname = "a"\n[camera]\nangle = 90', "kind perspective has no angle"),
        ('[mesh]\nname = "a"\n[camera]\nkind = "fisheye"\nangle = 361', "angle of a fisheye"),
        ('[mesh]\nname = "a"\n[camera]\nkind = "panorama"\nfov = 50', "fov is that of a perspective camera"),
        ('[mesh]\nname = "a"\n[camera]\nkind = "panorama"\naperture = 0.1', "no plane of focus"),
        ('[mesh]\nname = "a"\n[camera]\naperture = -1', "aperture must be"),
        ('[mesh]\nname = "a"\n[camera]\nfocus = 1', r"\[camera\] has an unknown key 'focus'; known are eye"),
        ('[mesh]\nname = "a"\n[image]\nwidth = 1.5', "width must be a whole number"),
        ('[mesh]\nname = "a"\n[image]\nwidth = 0', "width must be 1 to 65535 pixels"),
        ('[mesh]\nname = "a"\n[image]\nheight = true', "height must be a whole number"),
        ('[mesh]\nname = "a"\n[image]\nshading = "phong"', "shading must be one of lambert, "),
        ('[mesh]\nname = "a"\n[image]\nbackground = [1]', "background must be a colour"),
        ('[mesh]\nshape = "knot"\nseed = "x"', "seed must be a whole number"),
        ('[mesh]\nname = "a"\n[[object]]\nname = "b"', r"has no \[mesh\]: write it into the objects"),
        ('[transform]\nscale = 2\n[[object]]\nname = "b"', r"has no \[transform\]: write it into the objects"),
        ('[[object]]\nname = "a"\n[image]\nwidth = 0', "width must be 1 to 65535 pixels"),
        ('[[object]]\nname = "a"\ncolor = 3', r"\[object 1\] has an unknown key 'color'"),
        ("[mesh", "not a TOML file"),
    ],
)
def test_what_a_scene_must_not_say_is_named_with_its_file(read, text, message):
    with pytest.raises(SceneError, match=message) as caught:
        read(text)
    assert "scene.toml: " in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_scene_file_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"gone\.toml: no such scene file"):
        read_scene(tmp_path / "gone.toml")


def test_a_misspelt_scene_is_told_the_names():
    with pytest.raises(SceneError, match=r"bunni: no such file, and no shipped scene: these are bunny, cornell, demo"):
        open_scene("bunni")


def test_the_shipped_scenes_are_the_promised_ones():
    assert sorted(path.stem for path in find_folder("scenes").glob("*.toml")) == sorted(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scene_opens_by_its_name(name):
    assert isinstance(open_scene(name), Scene)


def test_the_meadow_has_10_000_instances_on_hills():
    scene = open_scene("meadow")
    assert len(scene.instances) == 10_001
    assert len(scene.geometries) == 4
    hills, others = scene.geometries[0].shape, scene.instances[1:]
    centres = np.array([instance.transform[:3, 3] for instance in others[::100]])
    # The grid of the terrain has a vertex within half a cell of each.
    nearest = [np.abs(hills.vertices[:, [0, 2]] - centre[[0, 2]]).max(axis=1).argmin() for centre in centres]
    assert np.abs(hills.vertices[nearest, 1] - centres[:, 1]).max() < 0.15


def test_the_galaxy_has_200_000_spheres():
    assert sum(geometry.shape.prim_count for geometry in open_scene("galaxy").geometries) == 200_000


def test_the_still_life_has_meshes_and_spheres():
    scene = open_scene("still-life")
    assert {type(geometry.shape) for geometry in scene.geometries} == {Mesh, Spheres}


@pytest.mark.parametrize("name", ["meadow", "galaxy", "hall", "still-life", "cornell", "weekend"])
def test_a_shipped_scene_of_objects_is_the_same_every_time(name):
    first, second = (open_scene(name).snapshot() for _ in range(2))
    assert first.transforms.tobytes() == second.transforms.tobytes()
    assert [shape.fingerprint for shape in first.shapes] == [shape.fingerprint for shape in second.shapes]


def test_the_weekend_has_spheres_of_chalk_metal_and_glass():
    scene = open_scene("weekend")
    (geometry,) = scene.geometries
    assert geometry.shape.prim_count == 480
    materials = [geometry.shape.appearance.materials[number] for number in geometry.shape.appearance.material_ids]
    glass, metal = (sum(bool(getattr(each, name)) for each in materials) for name in ("transmission", "metallic"))
    assert (10 < glass < 50, 40 < metal < 110, 330 < 480 - glass - metal < 420) == (True, True, True)
    assert scene.aperture > 0
    assert scene.light.colour == (0, 0, 0)


def test_the_cornell_box_has_one_lamp():
    scene = open_scene("cornell")
    lamps = [each.name for each in scene.instances if any(each.material.emission)]
    assert lamps == ["lamp"]
    assert {geometry.shape.name for geometry in scene.geometries} == {"square", "cube"}


def test_the_knot_has_the_size_of_the_dragon():
    assert open_scene("knot").mesh.triangles == 871_200


def test_anything_else_is_a_mesh_file(tmp_path, monkeypatch):
    assert open_scene("a.ply").mesh.path == "a.ply"
    # A file of that name comes before a shipped scene.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bunny").write_bytes(b"ply")
    assert open_scene("bunny").mesh.path == "bunny"


def test_a_transform_scales_then_turns_then_moves():
    mesh = Mesh.from_arrays([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]])
    moved = Transform(2, (0, 0, 90), (10, 0, 0)).apply(mesh)
    assert np.allclose(moved.vertices, [[10, 2, 0], [8, 0, 0], [10, 0, 2]], atol=1e-6)


def test_rotations_are_applied_about_x_then_y_then_z():
    mesh = Mesh.from_arrays([[0, 1, 0], [0, 0, 0], [1, 1, 1]], [[0, 1, 2]])
    moved = Transform(rotate=(90, 90, 0)).apply(mesh)
    assert np.allclose(moved.vertices[0], [1, 0, 0], atol=1e-6)  # y -> z -> x


def test_no_transform_leaves_the_mesh_as_it_is():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    assert Transform().apply(mesh) is mesh


@pytest.mark.parametrize("transform", [Transform(2, (10, 20, 30), (1, 2, 3)), Transform((1, -2, 3), (0, 90, 0))])
def test_the_matrix_moves_points_as_the_transform_does(transform):
    mesh = Mesh.from_arrays([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]])
    moved = mesh.vertices @ transform.matrix[:3, :3].T + transform.matrix[:3, 3]
    assert np.allclose(transform.apply(mesh).vertices, moved)


def test_a_scale_may_differ_between_the_axes():
    mesh = Mesh.from_arrays([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2]])
    moved = Transform((2, 3, 4), (0, 0, 90)).apply(mesh)
    assert np.allclose(moved.vertices, [[0, 2, 0], [-3, 0, 0], [0, 0, 4]])


@pytest.mark.parametrize("scale", [(1, 0, 1), (1, 2), (1, 2, float("nan")), "2", None])
def test_a_scale_that_is_none_is_refused(scale):
    with pytest.raises(SceneError, match="scale must be a finite number other than 0, or three of them"):
        Transform(scale=scale)


def test_a_scale_of_0_is_refused():
    with pytest.raises(SceneError, match="scale"):
        Transform(scale=0).apply(Mesh.from_arrays(np.eye(3), [[0, 1, 2]]))
