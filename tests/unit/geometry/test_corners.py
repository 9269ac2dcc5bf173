"""The boxes of spheres, and the corners by which builders see any shape."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from clbvh import Mesh, MeshError, Spheres
from clbvh.geometry.corners import Boxes, bound_spheres, find_corners

# The share of its radius by which a box is larger than its sphere, and the most that it may be larger besides, in
# roundings of the box's coordinates.
MARGIN = 2.0**-18
ROUNDING = 2.0**-24


def make_spheres(seed, smallest):
    rng = np.random.default_rng([seed, 9])
    count = 200
    return Spheres(rng.normal(size=(count, 3)) + 1e3, 10.0 ** rng.uniform(smallest, 0, count), name="atoms")


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("smallest", [-30, -9, -1])
def test_each_box_contains_its_sphere_and_a_margin_and_little_more(seed, smallest):
    spheres = make_spheres(seed, smallest)
    corners = bound_spheres(spheres)
    assert corners.shape == (200, 2, 3)
    assert np.abs(corners).max() <= 1
    for sphere in range(spheres.prim_count):
        radius = Fraction(float(spheres.local_radii[sphere])) * (1 + Fraction(MARGIN))
        for axis in range(3):
            centre = Fraction(float(spheres.local_centres[sphere, axis]))
            lower, upper = (Fraction(float(end(corners[sphere, :, axis]))) for end in (np.min, np.max))
            assert lower <= centre - radius
            assert centre + radius <= upper
            slack = 3 * ROUNDING * max(abs(lower), abs(upper)) + 2.0**-140
            assert centre - radius - lower <= slack
            assert upper - centre - radius <= slack


@pytest.mark.parametrize("radius", [1e-30, np.nextafter(1, 0), 1.0, 1e30])
def test_a_single_sphere_stays_within_local_coordinates(radius):
    corners = bound_spheres(Spheres([[0, 0, 0]], radius))
    assert np.abs(corners).min() >= 0.49
    assert np.abs(corners).max() <= 1


def test_the_corners_of_a_mesh_are_its_own():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    points, ids = find_corners(mesh)
    assert points is mesh.local_vertices
    assert ids is mesh.faces


def test_the_corners_of_spheres_are_those_of_their_boxes():
    spheres = make_spheres(0, -3)
    points, ids = find_corners(spheres)
    corners, boxes = points[ids], bound_spheres(spheres)
    assert (corners.min(axis=1) == boxes[:, 0]).all()
    assert (corners.max(axis=1) == boxes[:, 1]).all()


@pytest.mark.parametrize("size", [1e-100, 1.0, 1e100])
def test_local_boxes_contain_what_float64_has_of_them(size):
    generator = np.random.default_rng(4)
    lower = generator.normal(size=(100, 3)) * size
    upper = lower + generator.exponential(0.1, (100, 3)) * size
    boxes = Boxes.from_arrays(lower, upper, "boxes")
    assert (boxes.prim_count, boxes.name) == (100, "boxes")
    least, greatest = (boxes.corners[:, end].astype(np.float64) for end in range(2))
    assert (least <= (lower - boxes.origin) * boxes.scale).all()
    assert (greatest >= (upper - boxes.origin) * boxes.scale).all()
    assert 0.5 <= np.abs(boxes.corners).max() <= 1 + 2.0**-20


@pytest.mark.parametrize("corner", [np.nan, np.inf, 1.7e308, 1e160])
def test_boxes_that_float64_has_no_room_for_are_refused(corner):
    with pytest.raises(MeshError, match=r"^boxes: .* give it in another unit"):
        Boxes.from_arrays(np.array([[0, 0, -corner]]), np.array([[1, 1, corner]]), "boxes")
