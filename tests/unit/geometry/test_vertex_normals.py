"""Normals at vertices, weighted by the angles of the faces around."""

import numpy as np
import pytest
import trimesh

import clbvh

CUBE = trimesh.creation.box()


def test_corners_of_a_cube_have_the_normal_of_their_diagonal_however_its_sides_are_cut():
    # Faces per corner are from 3 to 6, which a mean without angles would show.
    mesh = clbvh.Mesh.from_arrays(CUBE.vertices, CUBE.faces)
    np.testing.assert_allclose(mesh.vertex_normals, np.sign(CUBE.vertices) / np.sqrt(3), atol=1e-15)


def test_repeated_vertices_are_one_point_and_signed_zeros_too():
    vertices = CUBE.vertices + 0.5
    corners = vertices[CUBE.faces].reshape(-1, 3)
    corners[::2][corners[::2] == 0] = -0.0
    mesh = clbvh.Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))
    np.testing.assert_allclose(mesh.vertex_normals, np.sign(corners - 0.5) / np.sqrt(3), atol=1e-15)


@pytest.mark.parametrize("seed", [0, 1])
def test_normals_are_those_of_the_formula(seed):
    generator = np.random.default_rng(seed)
    vertices = generator.normal(size=(30, 3))
    faces = np.array([generator.choice(30, 3, replace=False) for _ in range(60)])
    expected = np.zeros((30, 3))
    for face in faces:
        for corner in range(3):
            own, following, last = vertices[np.roll(face, -corner)]
            u, v = following - own, last - own
            normal = np.cross(u, v)
            angle = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
            expected[face[corner]] += angle * normal / np.linalg.norm(normal)
    with np.errstate(invalid="ignore"):
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    mesh = clbvh.Mesh.from_arrays(vertices, faces)
    np.testing.assert_allclose(mesh.vertex_normals, expected, atol=1e-10)
    assert np.isnan(mesh.vertex_normals[np.setdiff1d(np.arange(30), faces)]).all()


@pytest.mark.parametrize("unit", [1e-150, 1e-30, 1e30, 1e149])
def test_any_unit_gives_the_same_normals(unit):
    knot = clbvh.make_shape("knot", triangles=1000)
    normals = clbvh.Mesh.from_arrays(knot.vertices * unit, knot.faces).vertex_normals
    np.testing.assert_allclose(normals, knot.vertex_normals, atol=1e-12)


def test_a_power_of_two_gives_the_same_bytes():
    knot = clbvh.make_shape("knot", triangles=1000)
    scaled = clbvh.Mesh.from_arrays(knot.vertices * 2.0**-400, knot.faces)
    assert scaled.vertex_normals.tobytes() == knot.vertex_normals.tobytes()


def test_faces_without_area_pass_a_normal_on_and_loose_vertices_have_none():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [9, 9, 9]]
    mesh = clbvh.Mesh.from_arrays(vertices, [[3, 4, 5], [0, 1, 2], [0, 1, 3], [0, 0, 3]])
    np.testing.assert_array_equal(mesh.vertex_normals[:6], [[0, 0, 1]] * 6)
    assert np.isnan(mesh.vertex_normals[6]).all()
    assert np.isnan(mesh.with_vertices(mesh.vertices * [1, 0, 0]).vertex_normals).all()


def test_where_faces_cancel_each_other_the_widest_gives_the_normal():
    corners = [[0.1, 0.7, 0.3], [1, 0.2, 0.1], [0.4, 1, 0.9]]
    mesh = clbvh.Mesh.from_arrays(corners, [[0, 1, 2], [0, 2, 1]])
    single = clbvh.Mesh.from_arrays(corners, [[0, 1, 2]])
    np.testing.assert_allclose(mesh.vertex_normals, single.vertex_normals, atol=1e-15)
    # Both sides of a square, one of them in three triangles around its first corner: its widest face is the other's.
    square = [[0, 0, 0], [2, 0, 0], [2, 1, 0], [2, 2, 0], [0, 2, 0]]
    faces = [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 3], [0, 3, 4]]
    np.testing.assert_array_equal(clbvh.Mesh.from_arrays(square, faces).vertex_normals[0], [0, 0, -1])


def test_normals_are_computed_once_and_again_for_moved_vertices():
    mesh = clbvh.Mesh.from_arrays(CUBE.vertices, CUBE.faces)
    assert mesh.vertex_normals is mesh.vertex_normals
    moved = mesh.with_vertices(mesh.vertices * [1, 1, -1])
    np.testing.assert_allclose(moved.vertex_normals, mesh.vertex_normals * [-1, -1, 1], atol=1e-15)
