"""Rays that missed what they hit, or hit what they miss, by the rounding of a box or of a triangle."""

from fractions import Fraction

import numpy as np
import pytest

from clbvh import Hits, Mesh, Scene, Tracer, Transform, build, make_shape
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference
from clbvh.tree_layouts import TREE_LAYOUTS

from ..kernel.casting import open_caster
from ..rays import AXES, aim, as_float32, centred

# Corners, an origin relative to the middle of the box, a direction, and the triangle hit.
CASES = {
    # The box ends before the ray begins, at a negative t, that of the triangle rounds to zero or more.
    "begins-in-a-plane": (
        ([[-3, 2.5, 0], [-1, 0.5, 0], [2, -1.5, 0]], [[-2, -0.5, 0], [-3, -1.5, 0], [-1, 2.5, 0]]),
        [-1.873005747795105, 1.4832037687301636, 2.999629804544972e-16],
        [-0.3157864511013031, 0.5389906764030457, 0.00017183214367832989],
        0,
    ),
    # Triangles that overlap in one plane: boxes were culled with a slack relative to t, not to the corners.
    "grazing-from-above": (
        (
            [[-2, 0.5, 0], [3, 0.5, 0], [-2, -2.5, 0]],
            [[-3, -2.5, 0], [0, 2.5, 0], [-1, -2.5, 0]],
            [[-2, -0.5, 0], [-3, -1.5, 0], [-1, 2.5, 0]],
        ),
        [-1.8737452030181885, -2.2530648708343506, -0.00021493468375410885],
        [-0.5690650343894958, -0.3129706382751465, 0.22009311616420746],
        1,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_box_was_left_out_whose_triangle_is_hit(session, name):
    corners, origin, direction, prim_id = CASES[name]
    mesh = Mesh.from_arrays(np.reshape(corners, (-1, 3)), np.arange(3 * len(corners)).reshape(-1, 3))
    ray = mesh.origin + np.array([origin]), np.array([direction])
    with open_caster(session, mesh, None) as cast:
        expected = cast("closest_hit", *ray)
    assert expected["prim_id"].tolist() == [prim_id]
    assert expected["t"][0] >= 0
    for layout in TREE_LAYOUTS:
        with open_caster(session, mesh, build(mesh, leaf_size=1), layout) as cast:
            assert cast("closest_hit", *ray).tolist() == expected.tolist(), layout


def test_a_ray_in_the_face_of_a_box_left_it_before_it_entered(session):
    """The slab test once took 0 * FLT_MAX for a crossing at t = 0."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    cube = Mesh.from_arrays(corners, [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    # A corner, two sides, and the centre. A ray at one of the other corners and sides is taken for one beside.
    steps = [[0, 0], [0.5, 0], [0, 0.5], [0.5, 0.5]]
    with Tracer(build(cube, leaf_size=1), device=session.info) as tracer:
        for direction in AXES:
            origins = np.insert(steps, int(np.argmax(np.abs(direction))), 0.5, axis=1) - 3.5 * direction
            hits = tracer.closest_hit(origins, np.broadcast_to(direction, origins.shape))
            assert hits.t.tolist() == [3] * 4, direction


def exact_t(corners, origin, direction):
    """Return where a ray crosses the plane of three corners, by rational arithmetic."""
    a, b, c, start, way = (np.array([Fraction(float(x)) for x in vector]) for vector in (*corners, origin, direction))
    normal = np.cross(b - a, c - a)
    return float(np.dot(normal, a - start) / np.dot(normal, way))


@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_a_ray_that_crosses_a_sliver_at_a_small_angle_was_moved_to_its_far_edge(session, layout):
    """The limit below which a triangle counts as seen edge-on was that of one as wide as it is long."""
    corners = np.array([[0, 0, 0], [1, 2.0**-20, 0], [1, 0, 2.0**-20]])
    with Tracer(Mesh.from_arrays(corners, [[0, 1, 2]]), device=session.info, layout=layout) as tracer:
        for tilt in (2.0**-19, 2.0**-21, -(2.0**-20)):
            direction = np.array([1.0, 0, tilt])
            origin = np.float32(corners.mean(axis=0) - direction / 4).astype(np.float64)
            hit = tracer.closest_hit(origin, direction)
            assert hit.is_hit
            assert hit.t == pytest.approx(exact_t(corners, origin, direction), rel=1e-6)
            np.testing.assert_allclose(hit.locations, origin + hit.t * direction, rtol=0, atol=1e-9)


@pytest.mark.parametrize("from_plane", [True, False], ids=["in-plane", "to-plane"])
def test_a_ray_in_the_plane_of_a_thin_triangle_hit_it_from_any_distance(session, from_plane):
    """The areas that decide are differences of nearly equal products; in float32 one of them came out as zero."""
    generator, count = np.random.default_rng([13, 0]), 300
    a, step = generator.uniform(-1, 1, (2, count, 3))
    width = 10 ** generator.uniform(-8, -1, (count, 1))
    c = a + generator.uniform(-1, 2, (count, 1)) * step + width * generator.normal(size=(count, 3))
    corners = np.stack((a, a + step, c), axis=1).reshape(-1, 3)
    mesh = centred(Mesh.from_arrays(corners, np.arange(3 * count).reshape(-1, 3)))
    a, b, c = mesh.vertices[mesh.faces[generator.integers(0, count, 20_000)]].transpose(1, 0, 2)

    def points_of_planes():
        """A point in the plane of each triangle, on it or up to three of its sizes away."""
        i, j = generator.uniform(-2, 3, (2, len(a), 1))
        return as_float32(a + i * (b - a) + j * (c - a))

    starts = points_of_planes() if from_plane else generator.uniform(-2, 2, a.shape)
    origins, directions = aim(starts, points_of_planes())
    with Tracer(mesh, device=session.info) as tracer:
        hits = tracer.closest_hit(origins, directions)
    assert hits.count > 500
    differences = Reference(Scene(mesh).snapshot()).find_differences(Rays.make(origins, directions), hits)
    assert [str(difference) for difference in differences] == []


@pytest.mark.on_both
def test_rays_whose_three_numbers_are_one_number_in_memory_were_refused(tracer):
    zeros, ones = np.broadcast_to(0.0, (4, 3)), np.broadcast_to(1.0, (2, 4, 3))
    expected = tracer.closest_hit(zeros.copy(), ones.copy()).t
    assert tracer.closest_hit(zeros, ones).t.tobytes() == expected.tobytes()


def make_cone():
    turns = np.arange(64) * np.pi / 32
    rim, next_ones = np.arange(64), (np.arange(64) + 1) % 64
    vertices = np.stack([np.cos(turns), np.sin(turns), 0 * turns], axis=1)
    vertices = np.concatenate([vertices, [[0, 0, 0], [0, 0, np.tan(np.radians(71))]]])
    sides = [[next_ones, rim, 0 * rim + 64], [rim, next_ones, 0 * rim + 65]]
    return Mesh.from_arrays(vertices, np.concatenate([np.stack(side, axis=1) for side in sides]))


def make_wedge(degrees):
    ends = np.array([[0, 0], [1, 0], [1, np.tan(np.radians(degrees))]])
    vertices = np.concatenate([np.insert(ends, 2, z, axis=1) for z in (-0.5, 0.5)])
    vertices = vertices @ np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    faces = [[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]]
    return Mesh.from_arrays(vertices, faces)


def make_star():
    ball = make_shape("icosphere", triangles=320)
    tips = ball.vertices[ball.faces].mean(axis=1)
    tips, (a, b, c) = tips / np.linalg.norm(tips, axis=1, keepdims=True), ball.faces.T
    tip = np.arange(ball.face_count) + len(ball.vertices)
    faces = np.concatenate([np.stack(face, axis=1) for face in ((a, b, tip), (b, c, tip), (c, a, tip))])
    return Mesh.from_arrays(np.concatenate([0.3 * ball.vertices, tips]), faces)


ACUTE = {"cone": make_cone, "wedge-1": lambda: make_wedge(1), "wedge-10": lambda: make_wedge(10), "star": make_star}


@pytest.mark.parametrize("placed", [False, True], ids=["alone", "placed"])
@pytest.mark.parametrize("name", ACUTE)
def test_rays_from_a_surface_beside_an_acute_edge_left_through_the_wall(session, name, placed):
    """Start points were moved along the normal alone, and so through the wall."""
    mesh, generator, count = ACUTE[name](), np.random.default_rng(11), 40_000
    weights = generator.dirichlet([1, 1, 1], count)
    # As close to an edge, or to a corner, as any hit of 10^9 is.
    shrunk = generator.choice([1, 1e-3, 1e-4, 1e-5, 1e-6, 1e-9], (count, 3))
    weights *= shrunk
    weights /= weights.sum(axis=1, keepdims=True)
    faces = generator.integers(mesh.face_count, size=count)
    scene = Scene()
    geometry = scene.add(mesh)
    scene.place(geometry, Transform(rotate=(20, 40, 70), translate=(5, 3, 1), scale=3) if placed else None)
    with Tracer(scene if placed else mesh, device=session.info) as tracer:
        # Hits at those points, from inside.
        instances = np.zeros(count, np.int32) if placed else None
        hits = Hits(
            np.zeros(count), weights[:, 1], weights[:, 2], faces.astype(np.int32), is_front=np.zeros(count, bool),
            surface=tracer.closest_hit([0, 0, 0], [0, 0, 1]).surface, known_instance_id=instances,
        )  # fmt: skip
        origins, directions = hits.offset_origins(), generator.normal(size=(count, 3))
        into = np.einsum("ij,ij->i", directions, hits.normals) < 0
        directions[~into] -= 2 * np.einsum("ij,ij->i", directions, hits.normals)[~into, None] * hits.normals[~into]
        found = tracer.closest_hit(origins, directions)
        escaped = ~found.is_hit | found.is_front
        assert not escaped.any(), f"{escaped.sum()} of {count}"
        assert not (found.prim_id == faces).any()
        # Hardly any of them was moved farther than to where the walls are apart.
        moves = np.linalg.norm(origins - hits.locations, axis=1) * mesh.scale / (3 if placed else 1)
        assert moves.max() < 2.0**-8
