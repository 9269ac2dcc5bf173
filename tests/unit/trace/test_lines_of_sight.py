"""Who sees whom: points each other, and an eye or a camera faces."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.trace import sight_queries

EYE = np.array([0.5, 4.0, 7.0])


@pytest.fixture
def room():
    """The inside of a box from 0 to 4 with a plate across its middle, and the walls of each face."""
    low, high = 0.0, 4.0
    corners = np.array([[x, y, z] for x in (low, high) for y in (low, high) for z in (low, high)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    plate = np.array([[2, 1, 0], [2, 3, 0], [2, 3, 4], [2, 1, 4]], float)
    return clbvh.Mesh.from_arrays(np.concatenate((corners, plate)), [*faces, (8, 9, 10), (8, 10, 11)])


def test_lines_of_sight_are_those_of_rays_between_lifted_points(session, mesh):
    faces = np.random.default_rng(1).permutation(np.flatnonzero(~mesh.degenerate_faces))[:150]
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        points = tracer.points_on(faces)
        seen = {side: tracer.line_of_sight(points[:, None], points, side=side) for side in (None, "front", "back")}
        ways = points.locations - points.locations[:, None]
        ways[range(150), range(150)] = normals = points.normals
        starts, ends = points[:, None].offset_origins(towards=ways), points.offset_origins(towards=-ways)
        free = ~tracer.any_hit(starts, ends - starts, t_max=1)
    in_front = np.einsum("ijk,ik->ij", ways, normals) > 0
    for side, expected in (
        (None, free),
        ("front", free & in_front & in_front.T),
        ("back", free & ~in_front & ~in_front.T),
    ):
        np.fill_diagonal(expected, True)
        assert np.array_equal(seen[side], expected), side
    assert np.array_equal(seen[None], seen[None].T)
    assert 0 < seen["front"].sum() < seen[None].sum()


def test_a_plate_hides_what_is_behind_it_and_nothing_in_its_plane(session, room):
    left, right, over = [1.0, 2, 2], [3.0, 2, 2], [3.0, 0.5, 2]
    with clbvh.Tracer(room, device=session.info) as tracer:
        assert tracer.line_of_sight(left, [right, over, left]).tolist() == [False, False, True]
        assert tracer.line_of_sight([1.0, 0.5, 2], over)
        # Points on the plate, on walls and on edges of them see each other along a plane, and through the room.
        plate = tracer.points_on([12, 13], [1 / 3, 1 / 3, 1 / 3])
        floor = tracer.points_on([0, 0, 1], [[1, 0, 0], [0, 0.5, 0.5], [0, 0, 1]])
        assert tracer.line_of_sight(plate[:, None], plate).all()
        assert tracer.line_of_sight(floor[:, None], floor, side="front").all()
        assert tracer.line_of_sight(plate, left, side="front").tolist() != [
            *tracer.line_of_sight(plate, right, side="front")
        ]
        assert tracer.line_of_sight(plate, [left, right]).all()
        closest = tracer.closest_point([left, right])
        assert tracer.line_of_sight(closest, [left, right]).all()
        assert not tracer.line_of_sight(closest, [right, left]).any()


@pytest.mark.parametrize("offset", [0, 1e2, 1e6])
def test_faces_of_one_wall_see_each_other_however_small_and_turned(session, offset):
    cells = 40
    x, y = (each.ravel() for each in np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij"))
    corners = np.array([[[x, y], [x + 1, y], [x + 1, y + 1]], [[x, y], [x + 1, y + 1], [x, y + 1]]])
    flat = corners.transpose(3, 0, 1, 2).reshape(-1, 2) / cells
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    faces = np.arange(len(flat)).reshape(-1, 3)
    faces[::7] = faces[::7, ::-1]  # some are turned
    wall = clbvh.Mesh.from_arrays(np.column_stack((flat, np.zeros(len(flat)))) @ turn + offset, faces)
    with clbvh.Tracer(wall, device=session.info) as tracer:
        points = tracer.points_on(range(0, wall.face_count, 23))
        assert tracer.line_of_sight(points[:, None], points).all()
        assert tracer.line_of_sight(points[:, None], points, side="front").all()


def test_pairs_are_cast_part_by_part_and_masks_are_respected(session, world, monkeypatch):
    random = np.random.default_rng(2)
    a, b = random.uniform(-4, 4, (2, 7, 1, 3)), random.uniform(-4, 4, (5, 3))
    with clbvh.Tracer(world, device=session.info) as tracer:
        whole = tracer.line_of_sight(a, b)
        done = []
        monkeypatch.setattr(sight_queries, "_RAYS_AT_ONCE", 16)
        parts = tracer.line_of_sight(a, b, progress=lambda *each: done.append(each))
        assert tracer.line_of_sight(a, b, mask=0).all()
    assert whole.shape == (2, 7, 5)
    assert np.array_equal(whole, parts)
    assert not whole.all()
    assert done[-1] == (70, 70)
    assert len(done) == 5


def test_an_eye_and_a_camera_see_the_faces_of_their_pictures(session, mesh):
    camera = clbvh.Camera(eye=EYE * 3, look_at=(0, 0, 0), fov=30)
    flat = clbvh.Camera(eye=EYE * 3, look_at=(0, 0, 0), projection=clbvh.Orthographic(height=8))
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        by_eye = tracer.visible_prims(EYE * 3, 64, side="front")
        # A picture finds faces that are wide enough; samples find smaller ones, too.
        pictures = {}
        for one in (camera, flat):
            hits = tracer.closest_prim(*one.rays(500, 400))
            pictures[one] = np.unique(hits[hits >= 0])
        by_camera = {one: tracer.visible_prims(one, 64, width=500, height=400) for one in pictures}
        closest = tracer.closest_hit(EYE * 3, by_eye.locations - EYE * 3)
    assert (np.diff(by_eye.prim_id) > 0).all()
    assert (closest.prim_id == by_eye.prim_id).mean() > 0.99
    for one, prims in pictures.items():
        assert np.isin(prims, by_camera[one].prim_id).all()
    assert np.isin(by_eye.prim_id, by_camera[camera].prim_id).all()
    assert len(by_camera[camera].prim_id) < 1.01 * len(by_eye.prim_id)


def test_a_camera_sees_large_faces_of_which_a_part_is_in_the_picture(session):
    ground = [[-50, -50, 0], [50, -50, 0], [50, 50, 0], [-50, 50, 0]]
    scene = clbvh.Scene((ground, [[0, 1, 2], [0, 2, 3]]))
    scene.place(scene.add((ground, [[0, 1, 2]])), clbvh.Transform(scale=0.001, translate=(44.6, -40, 1)))
    camera = clbvh.Camera(eye=(44, -40, 3), look_at=(44.3, -40, 0), fov=5)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        seen = tracer.visible_prims(camera, width=40, height=30)
        assert np.column_stack((seen.instance_id, seen.prim_id)).tolist() == [[0, 0]]
        seen = tracer.visible_prims(clbvh.Camera(eye=(44, -40, 3), look_at=(44.3, -40, 0), fov=40), width=40, height=30)
        assert np.column_stack((seen.instance_id, seen.prim_id)).tolist() == [[0, 0], [1, 0]]
        assert len(tracer.visible_prims(camera, width=40, height=30, side="back").prim_id) == 0


def test_a_narrow_picture_and_the_back_see_less(session, mesh):
    narrow = clbvh.Camera(eye=EYE * 3, look_at=mesh.vertices[0], fov=1)
    with clbvh.Tracer(mesh, device=session.info) as tracer:
        everything = tracer.visible_prims(EYE * 3).prim_id
        few = tracer.visible_prims(narrow, width=10, height=10).prim_id
        assert 0 < len(few) < len(everything) / 4
        assert np.isin(few, everything).all()
        assert len(tracer.visible_prims(EYE * 3, side="back").prim_id) == 0
        assert len(tracer.visible_prims(EYE * 3, 1).prim_id) < len(everything)


def test_a_face_is_not_seen_from_its_edge(session):
    with clbvh.Tracer(clbvh.make_shape("cube", triangles=12), device=session.info) as tracer:
        assert len(tracer.visible_prims((3, 0.2, 0.5)).prim_id) == 2
        assert len(tracer.visible_prims((3, 0.2, 0.5), side="back").prim_id) == 0
        camera = clbvh.Camera(eye=(3, 0.2, 0.5), look_at=(0, 0.2, 0.5))
        assert len(tracer.visible_prims(camera, width=64, height=64).prim_id) == 2


def test_everything_around_an_eye_is_seen_and_nothing_that_is_not_there(session):
    ball = clbvh.make_shape("icosphere", triangles=320)
    with clbvh.Tracer(ball, device=session.info) as tracer:
        for projection in (clbvh.Panorama(), clbvh.Fisheye(angle=360)):
            camera = clbvh.Camera(eye=(0, 0, 0), look_at=(0, 0, 1), projection=projection)
            assert len(tracer.visible_prims(camera, width=400, height=400).prim_id) == 320
    point = clbvh.Mesh.from_arrays([*ball.vertices, [0, 0, 0]], [*ball.faces, [len(ball.vertices)] * 3])
    with clbvh.Tracer(point, device=session.info) as tracer:
        assert len(tracer.visible_prims([0, 0, 0.1]).prim_id) == 320
        every = tracer.points_on(range(321))
        assert tracer.line_of_sight(every, [0, 0, 0.1]).all()
    scene = clbvh.Scene(ball)
    with clbvh.Tracer(scene, device=session.info) as tracer:
        tracer.set_masks(0, 0)
        assert len(tracer.visible_prims([0, 0, 5]).prim_id) == 0


def test_what_does_not_fit_is_refused(session, room):
    with clbvh.Tracer(room, device=session.info) as tracer:
        miss = tracer.closest_hit([9, 9, 9], [0, 0, 1])
        for error, words, call in [
            (clbvh.ConfigError, "side", lambda: tracer.line_of_sight([0, 0, 1], [0, 0, 2], side="left")),
            (clbvh.QueryError, "broadcast", lambda: tracer.line_of_sight([[0, 0, 1]] * 2, [[0, 0, 2]] * 3)),
            (clbvh.ConfigError, "side", lambda: tracer.line_of_sight([0, 0, 1], [0, 0, 2], side=[])),
            (clbvh.QueryError, "masks", lambda: tracer.line_of_sight([0, 0, 1], [[0, 0, 2]] * 2, mask=[1, 2, 3])),
            (clbvh.QueryError, "b must be finite: some rays", lambda: tracer.line_of_sight([0, 0, 1], miss)),
            (clbvh.QueryError, "finite", lambda: tracer.line_of_sight([0, 0, np.nan], [0, 0, 2])),
            (clbvh.ConfigError, "samples", lambda: tracer.visible_prims([0, 0, 1], 0)),
            (clbvh.QueryError, "eye", lambda: tracer.visible_prims([[0, 0, 1]])),
        ]:
            with pytest.raises(error, match=words):
                call()
    with clbvh.Tracer(clbvh.Spheres([[0, 0, 0]], 1.0)) as tracer:
        assert not tracer.line_of_sight([0, 0, -3], [0, 0, 3])
        with pytest.raises(clbvh.QueryError, match="spheres"):
            tracer.visible_prims([0, 0, 3])
