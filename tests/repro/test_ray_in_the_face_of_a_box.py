"""Rays along an axis, in the face of a leaf's box, hit the triangles in that face.

The slab test once took 0 * FLT_MAX for a crossing at t = 0, and the ray left the box before it entered it.
"""

import numpy as np
import pytest

import clbvh

from ..rays import AXES


def make_cube():
    """The unit cube; its faces are the faces of the boxes of all leaves."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return clbvh.Mesh.from_arrays(corners, faces)


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize("direction", AXES, ids=["+x", "-x", "+y", "-y", "+z", "-z"])
def test_the_border_of_a_face_is_hit(direction):
    axis = int(np.argmax(np.abs(direction)))
    # A corner, two sides, and the centre. A ray at one of the other corners and sides is taken for one beside.
    steps = np.stack(np.meshgrid([0, 0.5], [0, 0.5]), axis=-1).reshape(-1, 2)
    origins = np.insert(steps, axis, 0.5, axis=1) - 3.5 * direction
    with clbvh.Tracer(clbvh.build(make_cube(), leaf_size=1)) as tracer:
        hits = tracer.closest_hit(origins, np.broadcast_to(direction, origins.shape))
    assert hits.is_hit.all()
    assert (hits.t == 3).all()
