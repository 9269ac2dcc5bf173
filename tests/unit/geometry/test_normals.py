"""Normals of faces, of vertices, and at corners, smooth below a crease angle; and tangents of textures."""

import numpy as np
import pytest
import trimesh

import clbvh
from clbvh import Mesh
from clbvh.geometry.appearance.appearance import find_flat_normals
from clbvh.geometry.joined_shapes import JoinedMeshes
from clbvh.geometry.smooth_normals import find_tangents, smooth_small

BOX = trimesh.creation.box()
CUBE = Mesh.from_arrays(BOX.vertices, BOX.faces)
KNOT = clbvh.make_shape("knot", triangles=1000)
# Two squares beside each other in the plane z = 0, which share an edge.
POINTS = np.array([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)], float)
FACES = np.array([(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)])
UP = np.tile(np.float32((0, 0, 1)), (len(FACES), 3, 1))


def slow_normals(vertices, faces, angle):
    """Return the normals by the formula, corner by corner."""
    points = np.unique(np.asarray(vertices) + 0.0, axis=0, return_inverse=True)[1].reshape(-1)[faces]
    corners = np.asarray(vertices, np.float64)[faces]
    u, v = np.roll(corners, -1, axis=1) - corners, np.roll(corners, -2, axis=1) - corners
    cross = np.cross(u[:, 0], v[:, 0])
    units = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    cosines = np.einsum("fci,fci->fc", u, v) / np.linalg.norm(u, axis=2) / np.linalg.norm(v, axis=2)
    weighted = units[:, None] * np.arccos(cosines)[..., None]
    is_near = (units @ units.T > np.cos(np.radians(angle))) | np.eye(len(faces), dtype=bool) | (angle == 180)
    expected = np.empty((len(faces), 3, 3))
    for face, corner in np.ndindex(len(faces), 3):
        expected[face, corner] = weighted[(points == points[face, corner]) & is_near[face][:, None]].sum(axis=0)
    return expected / np.linalg.norm(expected, axis=2, keepdims=True)


@pytest.mark.parametrize("is_soup", [False, True])
def test_normals_are_those_of_the_formula(is_soup):
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices = ball.vertices + np.random.default_rng(0).normal(scale=0.15, size=ball.vertices.shape)
    faces = ball.faces
    if is_soup:  # each face has vertices of its own
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    mesh = Mesh.from_arrays(vertices, faces)
    for angle in (0, 20, 40, 90, 180):
        normals = clbvh.smooth_normals_by_angle(mesh, angle)
        np.testing.assert_allclose(normals, slow_normals(vertices, faces, angle), atol=1e-6)
    np.testing.assert_allclose(mesh.vertex_normals[faces], slow_normals(vertices, faces, 180), atol=1e-10)
    around = mesh.corner_faces
    points = around.points[faces]
    for point, (begin, end) in enumerate(zip(around.begins[:-1], around.begins[1:], strict=True)):
        assert around.faces[begin:end].tolist() == np.flatnonzero((points == point).any(axis=1)).tolist()


def test_a_box_is_flat_below_its_right_angles_and_round_above():
    flat = np.repeat(BOX.face_normals[:, None], 3, axis=1)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(CUBE), flat, atol=1e-6)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(CUBE, 89.9), flat, atol=1e-7)
    diagonal = np.sign(BOX.vertices) / np.sqrt(3)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(CUBE, 90.1), diagonal[BOX.faces], atol=1e-6)
    # Faces per corner are from 3 to 6, which a mean without angles would show.
    np.testing.assert_allclose(CUBE.vertex_normals, diagonal, atol=1e-15)
    moved = CUBE.with_vertices(CUBE.vertices * [1, 1, -1])
    np.testing.assert_allclose(moved.vertex_normals, diagonal * [-1, -1, 1], atol=1e-15)
    # Signed zeros are one point.
    corners = (BOX.vertices + 0.5)[BOX.faces].reshape(-1, 3)
    corners[::2][corners[::2] == 0] = -0.0
    soup = Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))
    np.testing.assert_allclose(soup.vertex_normals, np.sign(corners - 0.5) / np.sqrt(3), atol=1e-15)


@pytest.mark.parametrize("unit", [1e-150, 1e-30, 1e149])
def test_any_unit_gives_the_same_normals(unit):
    scaled = Mesh.from_arrays(KNOT.vertices * unit, KNOT.faces)
    smooth = clbvh.smooth_normals_by_angle(KNOT, 40)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(scaled, 40), smooth, atol=1e-6)
    np.testing.assert_allclose(scaled.vertex_normals, KNOT.vertex_normals, atol=1e-12)
    corners = np.array([[[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[1, 1, 1]] * 3, [[0, 0, 0], [0, 0, 1e-9], [0, 1, 0]]])
    np.testing.assert_allclose(find_flat_normals(corners * unit), [[0, 0, 1], [0, 0, 1], [-1, 0, 0]], atol=1e-7)


def test_faces_without_area_take_normals_and_change_none():
    vertices = [[0, 0, 0], [0, 1, 0], [0, 0, 1], [0, 2, 0], [0, 3, 0], [0, 4, 0], [9, 9, 9]]
    mesh = Mesh.from_arrays(vertices, [[3, 4, 5], [0, 1, 2], [0, 1, 3], [0, 0, 3]])
    np.testing.assert_array_equal(mesh.vertex_normals[:6], [[1, 0, 0]] * 6)
    assert np.isnan(mesh.vertex_normals[6]).all()
    smooth = clbvh.smooth_normals_by_angle(mesh, 40)
    np.testing.assert_array_equal(smooth[1], [[1, 0, 0]] * 3)
    np.testing.assert_array_equal(smooth[2], [[1, 0, 0], [1, 0, 0], [0, 0, 1]])
    np.testing.assert_array_equal(smooth[0], [[0, 0, 1]] * 3)
    assert np.isnan(mesh.with_vertices(mesh.vertices * [0, 1, 0]).vertex_normals).all()


def find(points, uvs, normals=UP, faces=FACES):
    return find_tangents(Mesh.from_arrays(points, faces), normals, np.asarray(uvs, np.float32))


def test_tangents_of_a_plane_have_the_direction_of_u():
    for degrees, mirror, size, uv_size in ((0, 1, 1, 1e-30), (37, 1, 1e-30, 1), (90, -1, 1e30, 1), (300, -1, 1, 1e30)):
        # u grows along this direction, and v along the one at its left hand, or right hand if mirrored.
        angle = np.radians(degrees)
        along_u = np.array([np.cos(angle), np.sin(angle), 0])
        along_v = mirror * np.cross((0, 0, 1), along_u)
        uvs = np.stack((POINTS @ along_u, POINTS @ along_v), axis=-1)[FACES] * 3.7 * uv_size
        expected = np.broadcast_to([*along_u, mirror], (4, 3, 4))
        np.testing.assert_allclose(find(POINTS * size, uvs), expected, atol=1e-6)


def test_a_mirrored_half_has_tangents_of_its_own():
    # u grows from the shared edge to both sides; there all corners have the same coordinates.
    tangents = find(POINTS, np.stack((np.abs(POINTS[:, 0] - 1), POINTS[:, 1]), axis=-1)[FACES])
    np.testing.assert_allclose(tangents[:2], np.broadcast_to((-1, 0, 0, -1), (2, 3, 4)), atol=1e-6)
    np.testing.assert_allclose(tangents[2:], np.broadcast_to((1, 0, 0, 1), (2, 3, 4)), atol=1e-6)


def test_tangents_are_unit_vectors_at_right_angles_to_normals_even_without_a_direction():
    normals = np.random.default_rng(4).normal(size=(4, 3, 3)) * 0.3 + (0, 0, 1)
    bent = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    plain, line = POINTS[FACES][..., :2], np.tile([(0, 0), (1, 1), (2, 2)], (4, 1, 1))
    along = np.tile(np.float32((1, 0, 0)), (4, 3, 1))
    for uvs, at in ((plain, bent), (plain, along), (plain * 0, UP), (plain * 0, bent), (line, UP), (line, along)):
        tangents = find(POINTS, uvs, at)[..., :3]
        np.testing.assert_allclose(np.linalg.norm(tangents, axis=-1), 1, atol=1e-6)
        np.testing.assert_allclose(np.einsum("...i,...i->...", tangents, at), 0, atol=1e-6)
    # A face without an area changes no other.
    faces = np.concatenate((FACES, [(0, 1, 1), (1, 1, 1)]))
    tangents = find(POINTS, POINTS[faces][..., :2], np.tile(UP[:1], (6, 1, 1)), faces)
    np.testing.assert_allclose(tangents[:4], np.broadcast_to((1, 0, 0, 1), (4, 3, 4)), atol=1e-6)
    assert np.isfinite(tangents).all()


@pytest.mark.parametrize("angle", [20, 40, 180])
def test_meshes_that_are_smoothed_together_keep_their_points_to_themselves(angle):
    hinged = clbvh.Transform(rotate=(15, 0, 0)).matrix[:3, :3]  # the row y = 0 stays
    meshes = [Mesh.from_arrays(points, FACES) for points in (POINTS, POINTS @ hinged.T, POINTS)]
    meshes += [Mesh.from_arrays(KNOT.vertices * size, KNOT.faces) for size in (1e-140, 1e140)]
    # The products of sides in the file's unit are below the normal numbers.
    tiny = np.concatenate((KNOT.vertices * 1e-12, np.eye(3))) * 1e-148
    meshes.append(Mesh.from_arrays(tiny, np.concatenate((KNOT.faces, [len(KNOT.vertices) + np.arange(3)]))))
    meshes += [CUBE, CUBE, Mesh.from_arrays(np.ones((3, 3)), [[0, 1, 2]])]
    together = smooth_small(JoinedMeshes.of(meshes), angle)
    for mesh, begin in zip(meshes, np.cumsum([0, *(mesh.face_count for mesh in meshes)]).tolist(), strict=False):
        alone = clbvh.smooth_normals_by_angle(mesh, angle)
        assert together[begin : begin + mesh.face_count].tobytes() == alone.tobytes()
