"""Spikes: single vertices far away pull triangles with them; masts, grounds and cones do not count."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.geometry.spikes import LEAST_GAP
from clbvh.rendering.bulk import find_bulk

BALL = clbvh.make_shape("icosphere", triangles=1280)


def moved(vertices, places):
    points = BALL.vertices.copy()
    points[vertices] = places
    return clbvh.Mesh.from_arrays(points, BALL.faces)


def box_of(extent):
    return extent.origin + extent.local_box.astype(float) / extent.scale


@pytest.mark.parametrize("scale", [1e-30, 1, 1e30])
@pytest.mark.parametrize("place", [(60, 0, 0), (0, -90, 0), (1e5, 1e5, -1e5)])
def test_a_vertex_far_away_does_not_count(place, scale):
    mesh = moved([321], np.array(place))
    mesh = mesh.with_vertices(mesh.vertices * scale)
    bulk = find_bulk(mesh)
    assert bulk.note == "6 of 1,280 triangles (0.5 %) are far away from the others and are left out of the frame"
    np.testing.assert_allclose(box_of(bulk.extent) / scale, box_of(BALL), atol=0.05)


def test_vertices_far_away_on_several_sides_do_not_count():
    bulk = find_bulk(moved([100, 300, 500], [(60, 0, 0), (-70, 0, 0), (3, 900, 0)]))
    np.testing.assert_allclose(box_of(bulk.extent), box_of(BALL), atol=0.05)


def test_a_vertex_that_leaves_a_tenth_of_the_picture_counts():
    diagonal = np.linalg.norm(np.ptp(BALL.vertices, axis=0))
    near, far = 1 + diagonal * LEAST_GAP * 0.95, 1 + diagonal * LEAST_GAP * 1.05
    assert find_bulk(moved([321], (near, 0, 0))).note is None
    assert find_bulk(moved([321], (far, 0, 0))).note is not None


def test_a_mast_and_a_ground_count():
    """They have faces with two far corners."""
    face = BALL.faces[777]
    assert find_bulk(moved(face, np.add(BALL.vertices[face], (0, 80, 0)))).note is None
    ground = 900 * np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    count = len(BALL.vertices)
    faces = np.concatenate((BALL.faces, count + np.array([[0, 1, 2], [0, 2, 3]])))
    assert find_bulk(clbvh.Mesh.from_arrays(np.concatenate((BALL.vertices, ground)), faces)).note is None
