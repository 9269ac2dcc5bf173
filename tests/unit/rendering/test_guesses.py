"""What a picture guesses: which way is up, and which few parts are too far away to frame."""

import dataclasses

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.view_finder import Y_UP, Z_UP, find_outliers, frame_without_outliers, guess_up

CREATE = trimesh.creation
# From z up to y up.
TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
BALL = CREATE.icosphere(3)


def joined(*parts):
    """A mesh of solids, each with its place."""
    return as_mesh(trimesh.util.concatenate([solid.copy().apply_translation(place) for solid, place in parts]))


def as_mesh(solid):
    return clbvh.Mesh.from_arrays(solid.vertices, solid.faces)


def guess(mesh, kind=""):
    """Return the guess for a mesh that comes from a file of a kind."""
    return guess_up(SceneBounds.of_mesh(dataclasses.replace(mesh, name=f"a.{kind}")))


def bounds_of(scene):
    state = scene.snapshot()
    return SceneBounds(state.shapes, state.geometry_ids, state.transforms)


def box_of(bounds):
    return bounds.origin + bounds.local_box.astype(float) / bounds.scale


def test_a_mesh_stands_on_its_base_either_way():
    legs = [(CREATE.box((0.1, 0.1, 1)), (x, y, 0.5)) for x in (-1, 1) for y in (-1, 1)]
    solids = [CREATE.cone(1, 2), CREATE.cylinder(1, 2), CREATE.torus(1, 0.3), CREATE.box((3, 2, 0.1))]
    for mesh in [*map(as_mesh, solids), joined(*legs, (CREATE.box((2.4, 2.4, 0.1)), (0, 0, 1)))]:
        for unit in (1e-30, 1, 1e30):
            assert guess(mesh.with_vertices(mesh.vertices * unit), "obj").vector == Z_UP
            assert guess(mesh.with_vertices(mesh.vertices @ TURN.T * unit), "stl").vector == Y_UP


def test_the_format_decides_where_the_shape_does_not():
    flat = ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[5, 5, 5]] * 3)
    shapeless = [as_mesh(CREATE.box()), as_mesh(BALL), *(clbvh.Mesh.from_arrays(each, [[0, 1, 2]]) for each in flat)]
    for kind, up in {"stl": Z_UP, "STL": Z_UP, "off": Z_UP, "obj": Y_UP, "ply": Y_UP, "": Y_UP}.items():
        for mesh in shapeless:
            vector, note = guess(mesh, kind)
            assert vector == up, kind
            assert note is None if up == Y_UP else note.startswith("z is up: most ")
    for kind in ("glb", "gltf"):
        assert guess(as_mesh(CREATE.cone(1, 2)), kind) == (Y_UP, None)


def test_an_eye_straight_above_has_the_other_axis():
    bounds = SceneBounds.of_mesh(as_mesh(BALL))
    for place in ({"eye": (0, 9, 0)}, {"eye": (3, -9, 1), "look_at": (3, 0, 1)}):
        assert guess_up(bounds, **place) == (Z_UP, None)
    assert guess_up(bounds, (0, 9, 1)).vector == Y_UP


def cloud(seed, count=1000):
    return np.random.default_rng([81, seed]).random((count, 3))


def find(points, size=0.01):
    return np.flatnonzero(find_outliers(points, points + size, np.ones(len(points)))).tolist()


def test_many_large_or_few_things_are_no_outliers():
    points = cloud(4)
    points[:11] += [90, 0, 0]  # 1.1 %
    assert not find(points)
    points[:2] -= [90, 0, 0]
    assert len(find(points)) == 9
    sizes = np.full((len(points), 1), 0.01)
    sizes[5] = 0.05
    assert not find(points, sizes)
    assert not find(np.diag([1e6, 0, 0]), 0.01)
    assert not find(np.eye(500, 1) * np.full(3, 9.0), 0.0)  # all others in one place


def with_specks(*places):
    """The ball with small triangles at some places."""
    speck = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]])
    corners = np.concatenate([speck + place for place in places])
    faces = len(BALL.vertices) + np.arange(len(corners)).reshape(-1, 3)
    return clbvh.Mesh.from_arrays(np.vstack((BALL.vertices, corners)), np.vstack((BALL.faces, faces)))


def test_far_spheres_and_instances_are_left_out():
    centres = np.random.default_rng(83).normal(size=(400, 3))
    centres[9] = 0, 500, 0
    framed = frame_without_outliers(bounds_of(clbvh.Scene(clbvh.Spheres(centres, 0.1))))
    assert framed.note.startswith("1 of 400 primitives")
    assert np.abs(box_of(framed.bounds)).max() < 6
    scene = clbvh.Scene()
    scene.place_many(scene.add(as_mesh(BALL)), [clbvh.Transform(translate=(x, 0, 0)).matrix for x in range(5)])
    scene.place(scene.add(clbvh.Mesh.from_arrays(np.eye(3) / 20, [[0, 1, 2]])), clbvh.Transform(translate=(0, 0, 99)))
    framed = frame_without_outliers(bounds_of(scene))
    assert framed.note.startswith("1 of 6,401 triangles")
    np.testing.assert_allclose(box_of(framed.bounds), [[-1, -1, -1], [5, 1, 1]], atol=1e-5)


def test_ordinary_things_are_framed_as_a_whole():
    here, pole, flag = (0, 0, 0), (CREATE.cylinder(0.02, 60), (0, 0, 30)), (CREATE.box((1, 0.01, 0.5)), (0.5, 0, 60))
    meshes = [
        joined((CREATE.icosphere(4), here), pole, flag), joined((BALL, here), (BALL, (500, 0, 0))),
        joined((CREATE.box((1000, 1000, 0.1)), here), (CREATE.icosphere(4), (400, 300, 1))),
    ]  # fmt: skip
    sun_and_planets = clbvh.Spheres([[x, 0, 0] for x in (0, 9100, 17000, 23500, 35800)], [109, 0.38, 0.95, 1, 0.53])
    wholes = [*map(SceneBounds.of_mesh, meshes), bounds_of(clbvh.Scene(sun_and_planets))]
    wholes += [bounds_of(clbvh.open_scene(name)[0]) for name in ("demo", "meadow", "palace")]
    for bounds in wholes:
        assert frame_without_outliers(bounds) == (bounds, None)


@pytest.mark.parametrize("shading", ["depth", "studio"])
def test_the_picture_is_that_of_the_mesh_without_outliers(shading):
    mesh = with_specks((0, 0, -300), (0, 0, 300))
    view = {"width": 64, "height": 48, "shading": shading}
    picture, expected = clbvh.render(mesh, **view), clbvh.render(as_mesh(BALL), **view)
    np.testing.assert_allclose(picture.camera.eye, expected.camera.eye, rtol=0.01)
    assert abs(picture.rgb.astype(int) - expected.rgb).mean() < 4
    assert "--frame all" in picture.notes[0]
    whole = clbvh.render(mesh, frame="all", **view)
    assert whole.notes == ()
    assert np.linalg.norm(whole.camera.eye) > 100
    # A camera of one's own is nobody else's business.
    assert clbvh.render(mesh, camera=expected.camera, **view).notes == ()
