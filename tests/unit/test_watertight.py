"""No ray leaves a closed mesh unseen: from inside, at vertices, edges, along axes and anywhere.

The quick version: about a million rays. `make bench` runs the long one.
"""

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.geometry import Mesh
from clbvh.geometry.shapes import make_shape

from ..rays import AXES, aim, as_float32, centred, edge_midpoints

RAYS = 1 << 16

# Of the knot, see `make_shape`: two turns, three loops, the torus' radii, and how far from the curve is surely inside.
TURNS, LOOPS, RADIUS, TUBE = 2, 3, 2.0, 0.9
INSIDE = 0.2


def inside_sphere(count, generator):
    """Points of the ball of radius 0.9; the first ones are its centre."""
    points = generator.normal(size=(count, 3))
    points *= 0.9 * np.cbrt(generator.uniform(size=(count, 1))) / np.linalg.norm(points, axis=1, keepdims=True)
    points[: count // 8] = 0
    return points


def inside_knot(count, generator):
    """Points near the curve in the middle of the tube."""
    t = generator.uniform(0, 2 * np.pi, count)
    reach = RADIUS + TUBE * np.cos(LOOPS * t)
    curve = np.stack((reach * np.cos(TURNS * t), reach * np.sin(TURNS * t), TUBE * np.sin(LOOPS * t)), axis=1)
    offset = generator.normal(size=(count, 3))
    return curve + INSIDE * generator.uniform(size=(count, 1)) * offset / np.linalg.norm(offset, axis=1, keepdims=True)


MESHES = {
    "icosphere": (make_shape, {"name": "icosphere", "triangles": 5120}, inside_sphere),
    "knot": (make_shape, {"name": "knot", "triangles": 20_000, "seed": 1}, inside_knot),
}


@pytest.fixture(scope="module", params=MESHES)
def closed(request, _opened_device):
    """A closed mesh, a tracer of it, and a function that makes points inside."""
    make, options, inside = MESHES[request.param]
    rebased = make(**options)
    mesh = centred(rebased)
    # Every edge belongs to two triangles, once in each sense.
    edges = np.concatenate([mesh.faces[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))])
    assert np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))
    assert len(np.unique(edges, axis=0)) == len(edges)
    with Tracer(build(mesh), device=_opened_device.info) as tracer:
        yield mesh, tracer, lambda count, generator: as_float32(inside(count, generator) - rebased.origin)


def rays_at(mesh, targets, inside, generator):
    return aim(inside(RAYS, generator), targets[generator.integers(0, len(targets), RAYS)])


def at_vertices(mesh, inside, generator):
    return rays_at(mesh, mesh.vertices, inside, generator)


def at_edges(mesh, inside, generator):
    return rays_at(mesh, edge_midpoints(mesh), inside, generator)


def along_axes(mesh, inside, generator):
    """From points that share coordinates with vertices where that is inside: in the planes of boxes."""
    origins = inside(RAYS, generator)
    vertices = mesh.vertices[generator.integers(0, len(mesh.vertices), RAYS)].astype(np.float64)
    axis = generator.integers(0, 3, RAYS)[:, None] == np.arange(3)
    near = axis & (np.abs(vertices - origins) < 0.05)
    return np.where(near, vertices, origins), AXES[generator.integers(0, 6, RAYS)].astype(np.float64)


def nearly_along_axes(mesh, inside, generator):
    origins, directions = along_axes(mesh, inside, generator)
    tilt = 10 ** generator.uniform(-44, -4, directions.shape) * generator.choice([-1, 1], directions.shape)
    return origins, as_float32(np.where(directions == 0, tilt, directions))


def anywhere(mesh, inside, generator):
    return as_float32(inside(RAYS, generator)), as_float32(generator.normal(size=(RAYS, 3)))


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "make_rays", [at_vertices, at_edges, along_axes, nearly_along_axes, anywhere], ids=lambda f: f.__name__
)
def test_no_ray_escapes(closed, make_rays, seed):
    mesh, tracer, inside = closed
    origins, directions = make_rays(mesh, inside, np.random.default_rng([50, seed]))
    hits = tracer.closest_hit(origins, directions)
    assert np.flatnonzero(~hits.is_hit).tolist() == []
    assert tracer.any_hit(origins, directions).all()
    assert len(np.unique(hits.prim_id)) > 0.5 * min(mesh.face_count, 4000)


def test_an_open_mesh_leaks(closed):
    """The test can fail: one triangle less, and rays get out there."""
    mesh, _, inside = closed
    opened = Mesh(mesh.vertices, mesh.faces[1:], mesh.origin)
    origins, directions = aim(inside(100, np.random.default_rng(51)), mesh.vertices[mesh.faces[0]].mean(axis=0))
    with Tracer(build(opened)) as tracer:
        escaped = ~tracer.closest_hit(origins, directions).is_hit
    assert escaped.any()


def test_a_cube_is_closed_along_its_faces_and_edges(session):
    """The box of a mesh made of boxes: every leaf's box is flat or shares its faces."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    mesh = centred(Mesh.from_arrays(corners, faces))
    steps = np.linspace(-0.5, 0.5, 17)
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    with Tracer(build(mesh, leaf_size=1), device=session.info) as tracer:
        for direction in AXES.astype(np.float64):
            # From outside, one size away; the rays on the border run in the sides of the cube.
            axis = int(np.argmax(np.abs(direction)))
            origins = grid.copy()
            origins[:, axis] = -1.5 * direction[axis]
            hits = tracer.closest_hit(origins, np.broadcast_to(direction, origins.shape))
            assert (hits.t == 1).all()
            # From inside.
            inner = grid[(np.abs(grid) < 0.5).all(axis=1)]
            hits = tracer.closest_hit(inner, np.broadcast_to(direction, inner.shape))
            np.testing.assert_array_equal(hits.t, 0.5 - inner[:, axis] * direction[axis])
