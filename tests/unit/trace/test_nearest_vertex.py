"""The vertex nearest to each point."""

import numpy as np
import pytest

from clbvh import Mesh, build, make_shape
from clbvh.integrations.trimesh.nearest import find_nearest_vertices

from ...soup import make_soup


def expected_vertices(vertices, points):
    """Every vertex against every point; the first of those at the smallest distance."""
    distance = np.stack([np.linalg.norm(vertices - point, axis=1) for point in points])
    return distance.min(axis=1), distance.argmin(axis=1)


def check(mesh, points):
    distance, vertex_id = find_nearest_vertices(build(mesh), points)
    expected, expected_id = expected_vertices(mesh.vertices, points)
    np.testing.assert_allclose(distance, expected, rtol=1e-14)
    np.testing.assert_array_equal(vertex_id, expected_id)
    assert (distance.dtype, vertex_id.dtype) == (np.float64, np.int64)


@pytest.mark.parametrize("shape", ["icosphere", "knot", "terrain", "blobs"])
def test_against_every_vertex(shape):
    mesh = make_shape(shape, triangles=900)
    generator = np.random.default_rng(70)
    size = np.ptp(mesh.vertices, axis=0).max()
    anywhere = mesh.origin + generator.uniform(-1, 1, (400, 3)) * size
    close = mesh.vertices[generator.integers(0, len(mesh.vertices), 400)] + generator.normal(0, size / 100, (400, 3))
    check(mesh, np.concatenate((anywhere, close)))


@pytest.mark.parametrize("scale", [1e-100, 1e-30, 1e-6, 1e6, 1e30, 1e100])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_sizes_and_places(scale, shift):
    soup = make_soup(300, seed=71)
    mesh = Mesh.from_arrays((soup.vertices + shift) * scale, soup.faces)
    points = (np.random.default_rng(72).uniform(-2, 2, (300, 3)) + shift) * scale
    distance, vertex_id = find_nearest_vertices(build(mesh), points)
    expected, _ = expected_vertices(mesh.vertices / scale, points / scale)
    np.testing.assert_allclose(distance / scale, expected, rtol=1e-9)
    own = np.linalg.norm((mesh.vertices[vertex_id] - points) / scale, axis=1)
    np.testing.assert_allclose(own, expected, rtol=1e-9)


def test_vertices_of_no_face_count():
    mesh = Mesh.from_arrays([[5, 5, 5], [0, 0, 0], [1, 0, 0], [0, 1, 0], [-5, -5, -5]], [[1, 2, 3]])
    distance, vertex_id = find_nearest_vertices(build(mesh), np.array([[5.0, 5, 6], [-4, -5, -5], [0.9, 0, 0]]))
    assert vertex_id.tolist() == [0, 4, 2]
    np.testing.assert_allclose(distance, [1, 1, 0.1])


def test_the_smallest_of_equals():
    mesh = Mesh.from_arrays(
        [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, -1, 0]], [[3, 4, 5], [0, 1, 2]]
    )
    assert find_nearest_vertices(build(mesh), np.zeros((1, 3)))[1].tolist() == [0]


@pytest.mark.parametrize("far", [1e9, 1e20, 1e160, 1e300])
def test_far_away(far):
    mesh = make_shape("icosphere", triangles=320)
    way = np.array([[0.3, -0.5, 0.8]])
    distance, vertex_id = find_nearest_vertices(build(mesh), mesh.origin + way * far)
    highest = (mesh.vertices @ way[0]).max()
    assert mesh.vertices[vertex_id[0]] @ way[0] >= highest - 1e-4 * np.ptp(mesh.vertices)
    np.testing.assert_allclose(distance, np.linalg.norm(way) * far, rtol=1e-6)


def test_no_points():
    distance, vertex_id = find_nearest_vertices(build(make_shape("icosphere", triangles=80)), np.empty((0, 3)))
    assert distance.shape == vertex_id.shape == (0,)


def test_many_points_in_threads():
    mesh = make_shape("knot", triangles=600)
    points = np.random.default_rng(73).normal(size=(150_000, 3)) * np.ptp(mesh.vertices)
    bvh = build(mesh)
    distance, vertex_id = find_nearest_vertices(bvh, points)
    again = [find_nearest_vertices(bvh, part) for part in np.array_split(points, 7)]
    np.testing.assert_array_equal(vertex_id, np.concatenate([part[1] for part in again]))
    np.testing.assert_array_equal(distance, np.concatenate([part[0] for part in again]))
