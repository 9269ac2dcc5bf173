"""What pictures of the whole frame: outliers are left out, and ordinary things never are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh.rendering.cameras.bounds import SceneBounds
from clbvh.rendering.view_finder import frame_without_outliers

BALL = clbvh.make_shape("icosphere", triangles=1280)
BALL_BOX = [BALL.vertices.min(axis=0), BALL.vertices.max(axis=0)]
CREATE = trimesh.creation


def with_triangles(mesh, corners):
    """A mesh with more triangles, (n, 3, 3)."""
    corners = np.asarray(corners, float).reshape(-1, 3)
    faces = len(mesh.vertices) + np.arange(len(corners)).reshape(-1, 3)
    return clbvh.Mesh.from_arrays(np.concatenate((mesh.vertices, corners)), np.concatenate((mesh.faces, faces)))


def speck(*place):
    return np.array(place) + np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]])


def extent_of(scene):
    state = scene.snapshot()
    return SceneBounds(state.shapes, state.geometry_ids, state.transforms)


def box_of(extent):
    return extent.origin + extent.local_box.astype(float) / extent.scale


OUTLIERS = {
    "one": [speck(90, 0, 0)],
    "cluster": [speck(40, 40, place) for place in np.linspace(-5, 5, 12)],
    "both sides": [speck(90, 0, 0), speck(-60, 3, 0)],
    "very far": [speck(1e6, 1e6, 1e6)],
}


@pytest.mark.parametrize("name", OUTLIERS)
def test_a_mesh_is_framed_without_its_outliers(name):
    mesh = with_triangles(BALL, OUTLIERS[name])
    framed = frame_without_outliers(SceneBounds.of_mesh(mesh))
    assert f"{len(OUTLIERS[name])} of {mesh.face_count:,} triangle" in framed.note
    np.testing.assert_allclose(box_of(framed.bounds), BALL_BOX, atol=0.1)
    # And so is the instance of a scene, if it is alone.
    scene = clbvh.Scene()
    scene.place(scene.add(mesh), clbvh.Transform(translate=(3, 0, 0)))
    framed = frame_without_outliers(extent_of(scene))
    assert f"{len(OUTLIERS[name])} of {mesh.face_count:,} triangle" in framed.note
    np.testing.assert_allclose(box_of(framed.bounds), [[2, -1, -1], [4, 1, 1]], atol=0.1)


def test_far_vertices_without_triangles_are_not_framed():
    mesh = clbvh.Mesh.from_arrays(np.concatenate((BALL.vertices, [[500.0, 0, 0]])), BALL.faces)
    framed = frame_without_outliers(SceneBounds.of_mesh(mesh))
    assert framed.note is None
    np.testing.assert_allclose(box_of(framed.bounds), BALL_BOX, atol=1e-6)


def test_a_far_sphere_and_a_far_instance_are_left_out():
    generator = np.random.default_rng(83)
    centres = generator.normal(size=(400, 3))
    centres[9] = 0, 500, 0
    scene = clbvh.Scene()
    scene.place(scene.add(clbvh.Spheres(centres, 0.1)))
    framed = frame_without_outliers(extent_of(scene))
    assert framed.note.startswith("1 of 400 primitives")
    assert np.abs(box_of(framed.bounds)).max() < 6

    scene = clbvh.Scene()
    ball, small = scene.add(BALL), scene.add(clbvh.Mesh.from_arrays(speck(0, 0, 0), [[0, 1, 2]]))
    scene.place_many(ball, [clbvh.Transform(translate=(x, 0, 0)).matrix for x in range(5)])
    scene.place(small, clbvh.Transform(translate=(0, 0, 99)))
    framed = frame_without_outliers(extent_of(scene))
    assert framed.note.startswith("1 of 6,401 triangles")
    np.testing.assert_allclose(box_of(framed.bounds), [[-1, -1, -1], [5, 1, 1]], atol=1e-5)


def joined(*parts):
    solid = trimesh.util.concatenate(parts)
    return clbvh.Mesh.from_arrays(solid.vertices, solid.faces)


def moved(solid, *place):
    return solid.apply_translation(place)


ORDINARY = {
    "flagpole": joined(CREATE.icosphere(4), moved(CREATE.cylinder(0.02, 60), 0, 0, 30), CREATE.box((1, 0.01, 1))),
    "flag": joined(
        CREATE.icosphere(4), moved(CREATE.cylinder(0.02, 60), 0, 0, 30), moved(CREATE.box((1, 0.01, 0.5)), 0.5, 0, 60)
    ),
    "car": joined(
        CREATE.capsule(4, 1), moved(CREATE.cylinder(0.01, 3), 0, 0, 6), moved(CREATE.icosphere(1, 0.03), 0, 0, 7.6)
    ),
    "hanging lamp": joined(CREATE.box((2, 2, 0.1)), moved(CREATE.icosphere(1, 0.05), 0, 0, 4)),
    "two equal": joined(CREATE.icosphere(3), moved(CREATE.icosphere(3), 500, 0, 0)),
    "house on a plane": joined(CREATE.box((1000, 1000, 0.1)), moved(CREATE.icosphere(4), 400, 300, 1)),
    "one triangle": clbvh.Mesh.from_arrays(speck(0, 0, 0), [[0, 1, 2]]),
    "line": clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [9, 0, 0]], [[0, 1, 2]]),
    "point": clbvh.Mesh.from_arrays([[5, 5, 5]] * 3, [[0, 1, 2]]),
    "two triangles": with_triangles(clbvh.Mesh.from_arrays(speck(0, 0, 0), [[0, 1, 2]]), [speck(900, 0, 0)]),
    **{name: clbvh.make_shape(name, triangles=3000) for name in ("knot", "terrain", "blobs")},
}


@pytest.mark.parametrize("name", ORDINARY)
def test_ordinary_meshes_are_framed_as_a_whole(name):
    bounds = SceneBounds.of_mesh(ORDINARY[name])
    assert frame_without_outliers(bounds) == (bounds, None)


@pytest.mark.parametrize("seed", range(5))
def test_scattered_scenes_are_framed_as_a_whole(seed):
    generator = np.random.default_rng([84, seed])
    scene = clbvh.Scene()
    ball = scene.add(BALL)
    transforms = np.tile(np.eye(4), (300, 1, 1))
    transforms[:, :3, :3] *= generator.uniform(0.1, 3, (300, 1, 1))
    transforms[:, :3, 3] = 20 * generator.normal(size=(300, 3)) * [1, 0.01, 1]
    scene.place_many(ball, transforms)
    extent = extent_of(scene)
    assert frame_without_outliers(extent) == (extent, None)


@pytest.mark.parametrize("name", ["cornell", "demo", "galaxy", "meadow", "palace", "still-life", "weekend"])
def test_shipped_scenes_are_framed_as_a_whole(name):
    extent = extent_of(clbvh.open_scene(name)[0])
    assert frame_without_outliers(extent) == (extent, None)


def test_a_sun_and_its_planets_are_framed_as_a_whole():
    scene = clbvh.Scene()
    radii, places = [109, 0.38, 0.95, 1, 0.53], [0, 9100, 17000, 23500, 35800]
    scene.place(scene.add(clbvh.Spheres([[x, 0, 0] for x in places], radii)))
    assert frame_without_outliers(extent_of(scene)).note is None


@pytest.mark.parametrize("shading", ["lambert", "depth", "studio"])
def test_the_picture_is_that_of_the_mesh_without_outliers(shading):
    mesh = with_triangles(BALL, [speck(0, 0, -300), speck(0, 0, 300)])
    view = {"width": 64, "height": 48, "shading": shading}
    picture = clbvh.render(mesh, **view)
    expected = clbvh.render(BALL, **view)
    np.testing.assert_allclose(picture.camera.eye, expected.camera.eye, rtol=0.01)
    assert abs(picture.rgb.astype(int) - expected.rgb).mean() < 4
    assert "--frame all" in picture.notes[0]
    whole = clbvh.render(mesh, frame="all", **view)
    assert whole.notes == ()
    assert np.linalg.norm(whole.camera.eye) > 100
    # A camera of one's own is nobody else's business.
    assert clbvh.render(mesh, camera=expected.camera, **view).notes == ()


def test_other_frames_are_refused():
    with pytest.raises(clbvh.SceneError, match="frame must be one of auto, all"):
        clbvh.View(frame="middle")
