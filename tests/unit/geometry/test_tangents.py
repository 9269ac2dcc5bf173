"""Tangents of textures: along the growth of u, shared where the texture goes on, and apart where it is mirrored."""

from __future__ import annotations

import numpy as np
import pytest

import clbvh
from clbvh.geometry.smooth_normals import find_tangents

# Two squares beside each other in the plane z = 0, which share an edge.
POINTS = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)], float)
FACES = np.array([(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)])
UP = np.tile(np.float32((0, 0, 1)), (len(FACES), 3, 1))


def find(points, uvs, normals=UP, faces=FACES):
    return find_tangents(clbvh.Mesh.from_arrays(points, faces), normals, np.asarray(uvs, np.float32))


@pytest.mark.parametrize("scale", [1.0, 1e-30, 1e30])
@pytest.mark.parametrize("degrees", [0, 37, 90, 180, 300])
@pytest.mark.parametrize("mirror", [1, -1])
def test_a_plane_has_the_direction_of_u(degrees, mirror, scale):
    # u grows along this direction, and v along the one at its left hand, or right hand if mirrored.
    angle = np.radians(degrees)
    along_u = np.array([np.cos(angle), np.sin(angle), 0])
    along_v = mirror * np.cross((0, 0, 1), along_u)
    uvs = np.stack((POINTS @ along_u, POINTS @ along_v), axis=-1)[FACES] * 3.7
    tangents = find(POINTS * scale, uvs)
    np.testing.assert_allclose(tangents[..., :3], np.broadcast_to(along_u, UP.shape), atol=1e-6)
    assert (tangents[..., 3] == mirror).all()


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_the_size_of_coordinates_does_not_matter(size):
    tangents = find(POINTS, POINTS[FACES][..., :2] * size)
    np.testing.assert_allclose(tangents, np.broadcast_to((1, 0, 0, 1), (4, 3, 4)), atol=1e-6)


def test_a_mirrored_half_has_tangents_of_its_own():
    # u grows from the shared edge to both sides; there all corners have the same coordinates.
    uvs = np.stack((np.abs(POINTS[:, 0] - 1), POINTS[:, 1]), axis=-1)[FACES]
    tangents = find(POINTS, uvs)
    np.testing.assert_allclose(tangents[:2], np.broadcast_to((-1, 0, 0, -1), (2, 3, 4)), atol=1e-6)
    np.testing.assert_allclose(tangents[2:], np.broadcast_to((1, 0, 0, 1), (2, 3, 4)), atol=1e-6)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_corner_has_the_mean_by_angles(seed):
    # Faces around a point, each with a direction of u of its own; at the point they share the coordinates.
    generator = np.random.default_rng(seed)
    angles = np.array([0.0, 0.7, 1.1, 2.9, 4.0, 6.0])
    widths = np.diff(np.append(angles, 2 * np.pi))
    ring = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1) * generator.uniform(1, 3, (6, 1))
    points = np.concatenate((np.zeros((1, 3)), ring))
    faces = np.array([(0, 1 + face, 1 + (face + 1) % 6) for face in range(6)])
    turns = generator.uniform(-0.8, 0.8, 6)
    along_u = np.stack((np.cos(turns), np.sin(turns), 0 * turns), axis=-1)
    along_v = np.cross((0, 0, 1), along_u)
    uvs = np.stack((points[faces] @ along_u[..., None], points[faces] @ along_v[..., None]), axis=-1)[..., 0, :]
    tangents = find(points, uvs, np.tile(np.float32((0, 0, 1)), (6, 3, 1)), faces)
    expected = widths @ along_u
    np.testing.assert_allclose(
        tangents[:, 0, :3], np.broadcast_to(expected / np.linalg.norm(expected), (6, 3)), atol=1e-6
    )
    # The other corners have coordinates of their own.
    np.testing.assert_allclose(tangents[:, 1, :3], along_u, atol=1e-6)


def test_tangents_are_at_right_angles_to_bent_normals():
    generator = np.random.default_rng(4)
    normals = generator.normal(size=(4, 3, 3)) * 0.3 + (0, 0, 1)
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    tangents = find(POINTS, POINTS[FACES][..., :2], normals)
    np.testing.assert_allclose(np.linalg.norm(tangents[..., :3], axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("...i,...i->...", tangents[..., :3], normals), 0, atol=1e-6)
    # As near to the direction of u as they can be.
    assert (np.cross(normals, (1, 0, 0)) * np.cross(normals, tangents[..., :3])).sum(axis=-1).min() > 0


@pytest.mark.parametrize("uvs", [np.zeros((4, 3, 2)), np.tile([(0, 0), (1, 1), (2, 2)], (4, 1, 1))])
@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8)])
def test_coordinates_without_a_direction_give_some_tangent(uvs, normal):
    normals = np.tile(np.float32(normal), (4, 3, 1))
    tangents = find(POINTS, uvs, normals)
    np.testing.assert_allclose(np.linalg.norm(tangents[..., :3], axis=-1), 1, atol=1e-6)
    np.testing.assert_allclose(np.einsum("...i,...i->...", tangents[..., :3], normals), 0, atol=1e-6)


def test_a_face_without_an_area_changes_no_other():
    faces = np.concatenate((FACES, [(0, 1, 1), (1, 1, 1)]))
    normals = np.tile(np.float32((0, 0, 1)), (6, 3, 1))
    tangents = find(POINTS, POINTS[faces][..., :2], normals, faces)
    np.testing.assert_allclose(tangents[:4], np.broadcast_to((1, 0, 0, 1), (4, 3, 4)), atol=1e-6)
    assert np.isfinite(tangents).all()
