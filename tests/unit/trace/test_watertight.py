"""No ray leaves a closed mesh unseen: from inside, at vertices, edges, along axes and anywhere.

About two million rays; `make test-long` and `make bench` cast more.
"""

import numpy as np
import pytest

from clbvh import Tracer, build
from clbvh.geometry import Mesh

from ...closed_meshes import BUNNY, MAKERS, NAMES, open_closed_mesh, scan_path
from ...profiles import seeds
from ...rays import AXES, aim, centred, mesh_as_on_device

RAYS = 1 << 16


@pytest.fixture(scope="module", params=NAMES)
def closed(request, _opened_device):
    """A closed mesh, a tracer of it, and a function that makes points inside."""
    if request.param == "bunny" and not scan_path(BUNNY).is_file():
        pytest.skip(f"CLBVH_MESHES names no folder with {BUNNY}")
    mesh, inside = open_closed_mesh(request.param)
    with Tracer(build(mesh), device=_opened_device.info) as tracer:
        yield mesh, tracer, inside


@pytest.mark.parametrize("seed", seeds(2))
@pytest.mark.parametrize("make_rays", MAKERS, ids=lambda f: f.__name__)
def test_no_ray_escapes(closed, make_rays, seed):
    mesh, tracer, inside = closed
    origins, directions = make_rays(mesh, inside, RAYS, np.random.default_rng([50, seed]))
    hits = tracer.closest_hit(origins, directions)
    assert np.flatnonzero(~hits.is_hit).tolist() == []
    assert tracer.any_hit(origins, directions).all()
    # From inside, a ray goes out once more than it goes in.
    assert np.flatnonzero(tracer.count_hits(origins, directions) % 2 == 0).tolist() == []
    assert len(np.unique(hits.prim_id)) > 0.5 * min(mesh.face_count, 4000)


def test_an_open_mesh_leaks(closed):
    """The test can fail: one triangle less, and rays get out there."""
    mesh, _, inside = closed
    opened = mesh_as_on_device(mesh.vertices, mesh.faces[1:])
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
