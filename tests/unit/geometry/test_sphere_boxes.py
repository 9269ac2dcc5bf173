"""The boxes of spheres as a mesh."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from clbvh import Mesh, Spheres
from clbvh.geometry.box_mesh import mesh_of, sphere_boxes

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
    mesh = sphere_boxes(spheres)
    assert (mesh.face_count, mesh.name, mesh.scale) == (200, "atoms", spheres.scale)
    assert mesh.origin.tobytes() == spheres.origin.tobytes()
    assert np.abs(mesh.local_vertices).max() <= 1
    corners = mesh.local_vertices[mesh.faces]
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


def test_the_corners_are_those_of_the_boxes_in_the_units_of_the_spheres_as_well():
    spheres = make_spheres(0, -3)
    mesh = sphere_boxes(spheres)
    assert mesh.to_local(mesh.vertices) == pytest.approx(mesh.local_vertices, abs=1e-12)


@pytest.mark.parametrize("radius", [1e-30, np.nextafter(1, 0), 1.0, 1e30])
def test_a_single_sphere_stays_within_local_coordinates(radius):
    mesh = sphere_boxes(Spheres([[0, 0, 0]], radius))
    assert np.abs(mesh.local_vertices).min() >= 0.49
    assert np.abs(mesh.local_vertices).max() <= 1


def test_a_mesh_is_its_own():
    mesh = Mesh.from_arrays(np.eye(3), [[0, 1, 2]])
    assert mesh_of(mesh) is mesh
    assert mesh_of(Spheres(np.eye(3), 1)).face_count == 3
