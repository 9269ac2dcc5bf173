"""Framing: cameras that see the whole and waste no room; which way is up, and what is too far away to frame."""

import dataclasses

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Fisheye, Mesh, Orthographic, Panorama, SceneError, View
from clbvh.choices import STANDARD_VIEWS
from clbvh.views.cameras.bounds import SceneBounds
from clbvh.views.cameras.framing import frame_mesh, frame_scene
from clbvh.views.ground import sky_direction
from clbvh.views.view_finder import Y_UP, Z_UP, ViewFinder, find_outliers, frame_without_outliers, guess_up

HEIGHT = 90
MARGIN = 0.06
SKEW = (0.2, 1, -0.4)


def cloud(seed, extents=(3, 1, 0.4), count=300):
    return np.random.default_rng([9, seed]).normal(size=(count, 3)) * extents + [7, 8, 9]


def mesh_of(points):
    """A mesh with these vertices; its triangle does not matter."""
    return Mesh.from_arrays(points, np.repeat(np.arange(len(points)), 3).reshape(-1, 3))


def places(camera, points, aspect):
    """Places in the picture, -1 to 1 from edge to edge, and the depths."""
    pixels, depth = camera.project(points, round(HEIGHT * aspect), HEIGHT)
    return pixels / [HEIGHT * aspect / 2, HEIGHT / 2] - 1, depth


def check_frame(camera, points, aspect):
    """Every point is seen; along one direction the points reach the margin on both sides; the other is centred."""
    found, depth = places(camera, points, aspect)
    assert (depth > 0).all()
    assert np.abs(found).max() <= 1 - MARGIN + 1e-5
    tight = np.argmax(np.ptp(found, axis=0))
    assert np.ptp(found, axis=0)[tight] > 1.85
    off_centre = np.abs(found.max(axis=0) + found.min(axis=0))
    assert off_centre[tight] < 1e-5
    assert off_centre.max() < 0.02


@pytest.mark.parametrize("projection", [None, Orthographic()])
def test_every_point_is_seen_and_no_room_is_wasted(projection):
    for seed, (aspect, up) in enumerate([(16 / 9, (0, 1, 0)), (0.5, (0, 0, 1)), (1.0, SKEW)]):
        for extents in ((3, 1, 0.4), (0.5, 4, 5)):
            points = cloud(seed, extents)
            check_frame(frame_mesh(mesh_of(points), aspect=aspect, up=up, projection=projection), points, aspect)


@pytest.mark.parametrize("projection", [None, Orthographic(), Fisheye(150), Panorama()])
def test_neither_scale_nor_place_nor_a_lack_of_extent_matters(projection):
    points = cloud(1)
    expected = places(frame_mesh(mesh_of(points), aspect=1.5, projection=projection), points, 1.5)[0]
    for scale in (1e-100, 1e100):
        moved = (points + np.array([5e5, -4e6, 120.0])) * scale
        camera = frame_mesh(mesh_of(moved), aspect=1.5, projection=projection)
        np.testing.assert_allclose(places(camera, moved, 1.5)[0], expected, atol=1e-6)
    for points in (np.zeros((1, 3)), np.array([[0, 0, 0], [0, 1, 0.0]]), np.eye(3)):
        camera = frame_mesh(mesh_of(points), aspect=1, projection=projection, turns=projection != Panorama())
        assert np.isfinite(camera.rays(8, 8)[1]).all()
        assert projection == Panorama() or np.abs(places(camera, points, 1)[0]).max() < 1


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 3), SKEW])
def test_a_turn_sees_every_point_from_all_sides(up):
    for aspect, projection in ((16 / 9, None), (0.5, None), (0.5, Orthographic()), (2.0, Fisheye(120))):
        for points in (cloud(4, (3, 1, 0.2), 60), cloud(4, (0.5, 4, 5), 60)):
            first = frame_mesh(mesh_of(points), aspect=aspect, up=up, projection=projection, turns=True)
            seen = [places(first.orbit(angle), points, aspect) for angle in range(0, 360, 2)]
            assert min(depth.min() for _, depth in seen) > 0
            found = np.concatenate([each for each, _ in seen])
            assert np.abs(found).max() < 1 - MARGIN + 1e-4
            # The pictures stay where they are: the line of sight goes through the axis.
            centre = (points.min(axis=0) + points.max(axis=0)) / 2
            assert np.linalg.norm(np.cross(np.subtract(first.look_at, centre), up)) < 1e-5
            if not isinstance(projection, Fisheye):
                tight = np.argmax(np.ptp(found, axis=0))
                assert found[:, tight].max() > 0.933
                assert found[:, tight].min() < -0.933


def test_a_panorama_stands_in_the_middle_and_looks_level():
    points = cloud(3)
    camera = frame_mesh(mesh_of(points), aspect=2, up=(0, 0, 2), projection=Panorama())
    np.testing.assert_allclose(camera.eye, (points.min(axis=0) + points.max(axis=0)) / 2, rtol=1e-6)
    assert abs(camera.axes()[2][2]) < 1e-12


@pytest.mark.parametrize("projection", [None, Orthographic(), Orthographic(3), Fisheye(), Panorama()])
def test_a_view_gives_its_camera_the_projection_the_lens_and_the_eye(projection):
    points = cloud(6)
    finder = ViewFinder(SceneBounds.of_mesh(mesh_of(points)))
    lens = {} if isinstance(projection, Fisheye | Panorama) else {"aperture": 0.5, "focus_distance": 4}
    size = {"width": 150, "height": 100}
    # The eye is beside the middle.
    for place in ({}, {"eye": (20, 30, 40)}, {"eye": (20, 30, 40), "look_at": (6, 8, 9)}):
        camera = finder.camera(finder.complete(View(projection=projection, **place, **lens, **size)))
        assert (camera.aperture, camera.focus_distance) == ((0.5, 4) if lens else (0, None))
        if "eye" in place:
            middle = tuple((points.min(axis=0) + points.max(axis=0)) / 2)
            assert camera.eye == place["eye"]
            assert camera.look_at == pytest.approx(place.get("look_at", middle))
        if projection == Orthographic():
            assert np.abs(places(camera, points, 1.5)[0]).max() == pytest.approx(1 - MARGIN, abs=1e-5)
        else:
            assert camera.projection == projection


@pytest.mark.parametrize(("up", "front"), [((0, 1, 0), (0, 0, 1)), ((0, 0, 2), (0, -1, 0))])
def test_a_standard_view_is_from_its_side(up, front):
    points, above, front = cloud(0), np.array(up) / np.linalg.norm(up), np.array(front)
    right = np.array((1, 0, 0))
    sides = {
        "front": front, "right": right, "back": -front, "left": -right, "top": above, "bottom": -above,
        "iso": (front + right + above) / np.sqrt(3),
    }  # fmt: skip
    assert tuple(sides) == STANDARD_VIEWS
    for side, towards in sides.items():
        camera = frame_mesh(mesh_of(points), aspect=1.5, up=up, side=side)
        np.testing.assert_allclose(-camera.axes()[2], towards, atol=1e-12)
        np.testing.assert_allclose(camera.up, {"top": -front, "bottom": front}.get(side, up))
        found, depth = places(camera, points, 1.5)
        assert depth.min() > 0
        assert 1.85 / 2 < np.abs(found).max() < 0.9401
        # The sky is above, also in the view from the top.
        assert (sky_direction(View(side=side, up=up), camera) == above).all()
    # The automatic view is from the front, a little from the right and above.
    towards = -frame_mesh(mesh_of(points), aspect=1, up=up).axes()[2]
    assert towards @ front > towards @ right > towards @ above > 0.2


def test_a_renderer_takes_one_side_after_the_other(mesh):
    size = {"width": 40, "height": 30, "shading": "normal"}
    with clbvh.Renderer(mesh, eye=(1, 2, 3), up="y", **size) as renderer:
        for side in ("top", "left"):
            camera = renderer.render(side=side).camera
            assert camera == frame_mesh(mesh, aspect=4 / 3, side=side)
        with pytest.raises(SceneError, match="'top' and a camera"):
            renderer.render(side="top", camera=camera)


def test_bounds_and_cameras_of_a_scene_are_those_of_all_its_vertices():
    shapes = [clbvh.make_shape("icosphere", triangles=320), clbvh.make_shape("knot", triangles=200), mesh_of(np.eye(3))]
    for count in (1, 7, 2000):
        generator = np.random.default_rng(count)
        transforms = np.tile(np.eye(4), (count, 1, 1))
        transforms[:, :3] = generator.normal(size=(count, 3, 4)) * [1, 1, 1, count / 40 + 5]
        ids = generator.integers(0, len(shapes), count)
        parts = [shapes[i].vertices @ place[:3, :3].T + place[:3, 3] for i, place in zip(ids, transforms, strict=True)]
        points, bounds = np.concatenate(parts), SceneBounds(shapes, ids, transforms)
        box = bounds.origin + bounds.local_box / bounds.scale
        np.testing.assert_allclose(box, [points.min(axis=0), points.max(axis=0)], rtol=0, atol=1e-10)
        check_frame(frame_scene(bounds, aspect=1.5, up=SKEW), points, 1.5)


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
    for kind in ("3mf", "step", "stp"):
        vector, note = guess(as_mesh(CREATE.cone(1, 2)).with_vertices(CREATE.cone(1, 2).vertices @ TURN.T), kind)
        assert (vector, note.startswith(f"z is up: {kind.upper()} files have it so")) == (Z_UP, True)


def test_an_eye_straight_above_has_the_other_axis():
    bounds = SceneBounds.of_mesh(as_mesh(BALL))
    for place in ({"eye": (0, 9, 0)}, {"eye": (3, -9, 1), "look_at": (3, 0, 1)}):
        assert guess_up(bounds, **place) == (Z_UP, None)
    assert guess_up(bounds, (0, 9, 1)).vector == Y_UP


def even_cloud(seed, count=1000):
    return np.random.default_rng([81, seed]).random((count, 3))


def find(points, size=0.01):
    return np.flatnonzero(find_outliers(points, points + size, np.ones(len(points)))).tolist()


def test_many_large_or_few_things_are_no_outliers():
    points = even_cloud(4)
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
