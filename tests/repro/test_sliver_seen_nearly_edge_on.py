"""A ray that crosses a sliver at a small angle was moved to the far edge, though float64 knows where it crosses.

The limit below which a triangle counts as seen edge-on was that of a triangle as wide as it is long. The exact answers
are those of rational arithmetic.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from clbvh import Mesh, Tracer

# Corners in powers of two, exact in float32; the sliver is thinner than a millionth of its length.
LENGTH, WIDTH = 1.0, 2.0**-20


def cross(one, other):
    return [
        one[(axis + 1) % 3] * other[(axis + 2) % 3] - one[(axis + 2) % 3] * other[(axis + 1) % 3] for axis in range(3)
    ]


def subtract(one, other):
    return [left - right for left, right in zip(one, other, strict=True)]


def dot(one, other):
    return sum(left * right for left, right in zip(one, other, strict=True))


def exact_t(corners, origin, direction):
    """Return where a ray crosses the plane of three corners."""
    a, b, c = ([Fraction(float(value)) for value in corner] for corner in corners)
    start, way = ([Fraction(float(value)) for value in vector] for vector in (origin, direction))
    normal = cross(subtract(b, a), subtract(c, a))
    return float(dot(normal, subtract(a, start)) / dot(normal, way))


@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
@pytest.mark.parametrize("tilt", [2.0**-19, 2.0**-21, -(2.0**-20)])
def test_t_is_that_of_the_plane(tilt, layout):
    corners = np.array([[0, 0, 0], [LENGTH, WIDTH, 0], [LENGTH, 0, WIDTH]])
    middle = corners.mean(axis=0)
    direction = np.array([1.0, 0, tilt])
    origin = np.float32(middle - direction / 4).astype(np.float64)
    with Tracer(Mesh.from_arrays(corners, [[0, 1, 2]]), layout=layout) as tracer:
        hit = tracer.closest_hit(origin, direction)
    assert hit.is_hit
    assert hit.t == pytest.approx(exact_t(corners, origin, direction), rel=1e-6)
    np.testing.assert_allclose(hit.locations, origin + hit.t * direction, rtol=0, atol=1e-9)


@pytest.mark.parametrize("layout", ["bvh2", "bvh8"])
def test_a_ray_that_begins_just_behind_the_plane_meets_the_edge_there(layout):
    """The rounded ray meets the sliver; the exact one would have before it begins, 3e-5 away."""
    corners = [
        [0.6679758429527283, -0.27254775166511536, 0.37642741203308105],
        [-0.08242901414632797, -0.8467452526092529, -0.6928091645240784],
        [0.8109192848205566, -0.1631697416305542, 0.580104649066925],
    ]
    origin = np.array([0.597565770149231, -0.32642439007759094, 0.2761015295982361])
    direction = np.array([0.4433019459247589, 0.3391883075237274, 0.6316400766372681])
    # Keeps local coordinates equal to these.
    frame = [[-1, -1, -1], [1, 1, 1], [1, 1, 0.75]]
    mesh = Mesh.from_arrays([*corners, *frame], [[0, 1, 2], [3, 4, 5]])
    with Tracer(mesh, layout=layout) as tracer:
        hits = tracer.all_hits(origin, direction)
    t = hits.t[hits.prim_id == 0]
    assert len(t) == 1
    # The device sees corners 2e-7 from where they are, and the ray meets the plane at an angle of 1e-5.
    assert 0 <= t[0] < 0.02
