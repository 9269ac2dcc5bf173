"""Polygons to triangles: order, winding, dents."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh.errors import MeshError
from clbvh.geometry.polygons import cut_polygons

ANGLES = np.arange(8) * (2 * np.pi / 8)
OCTAGON = np.column_stack((np.cos(ANGLES), np.sin(ANGLES), np.zeros(8)))


def areas(vertices, faces):
    """Signed areas of triangles in the xy plane."""
    a, b, c = (vertices[faces[:, corner], :2] for corner in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return (ux * vy - uy * vx) / 2


def test_polygons_become_fans_where_they_stand():
    corners = np.array([0, 1, 2, 0, 2, 4, 6, 1, 2, 3, 4, 5, 5, 6, 7])
    faces = cut_polygons(OCTAGON, corners, np.array([3, 4, 5, 3]), source="x")
    assert faces.tolist() == [[0, 1, 2], [0, 2, 4], [0, 4, 6], [1, 2, 3], [1, 3, 4], [1, 4, 5], [5, 6, 7]]
    assert faces.dtype == np.int32


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("reverse", [False, True])
def test_a_dented_quad_is_cut_along_its_inner_diagonal(first, axis, reverse):
    arrow = np.array([[0, 0, 0], [2, -1, 0], [0.5, 0, 0], [2, 1, 0]], dtype=float)  # the dent is vertex 2
    order = np.roll(np.arange(4), first)
    order = order[::-1] if reverse else order
    faces = cut_polygons(np.roll(arrow, axis, axis=1), order, np.array([4]), source="x")
    assert all({0, 2} <= set(face) for face in faces.tolist())
    signed = areas(arrow, faces)
    assert (signed > 0).all() or (signed < 0).all()
    assert abs(signed.sum()) == pytest.approx(0.5)


@pytest.mark.parametrize("seed", range(5))
def test_a_star_is_covered_exactly_once(seed):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 15))
    radii = rng.uniform(0.2, 1, 15)
    star = np.column_stack((radii * np.cos(angles), radii * np.sin(angles), np.zeros(15)))
    faces = cut_polygons(star, np.arange(15), np.array([15]), source="x")
    x, y, _ = star.T
    shoelace = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    assert len(faces) == 13
    assert (areas(star, faces) >= 0).all()
    assert areas(star, faces).sum() == pytest.approx(shoelace)


def test_degenerate_and_self_crossing_polygons_are_cut_all_the_same():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    corners = np.array([0, 0, 0, 0, 0, 2, 1, 3, 0, 1, 2, 3])
    faces = cut_polygons(vertices, corners, np.array([4, 4, 4]), source="x")
    assert faces.shape == (6, 3)
    assert faces[4:].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("corners", "sizes", "message"),
    [
        ([0, 1, 2, 3, 4], [3, 2], "face 1 has 2 corners"),
        ([0, 1, 2, 3, 4, 8], [3, 3], r"face 1 refers to vertex 8, .* 8 vertices \(0 to 7\)"),
        ([0, 1, -2, 3, 4, 5], [3, 3], "face 0 refers to vertex -2"),
        ([0.0, 1.0, 1.5], [3], "face 0 refers to vertex 1.5"),
        ([0.0, 1.0, np.nan], [3], "face 0 refers to vertex nan"),
        ([0.0, 1.0, np.inf], [3], "face 0 refers to vertex inf"),
        ([0.0, 1.0, 1e300], [3], r"face 0 refers to vertex 1e\+300"),
    ],
)
def test_bad_polygons_are_named(corners, sizes, message):
    with pytest.raises(MeshError, match=message):
        cut_polygons(OCTAGON, np.array(corners), np.array(sizes), source="x")
