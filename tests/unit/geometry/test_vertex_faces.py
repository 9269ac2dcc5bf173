"""The faces around each vertex."""

import numpy as np
import pytest

from clbvh import Mesh, make_shape
from clbvh.geometry.smooth_normals import find_vertex_faces


def faces_at(around, vertex):
    point_id = around.point_ids[vertex]
    return around.faces[around.begin[point_id] : around.begin[point_id + 1]].tolist()


def test_two_triangles_with_an_edge():
    mesh = Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    around = find_vertex_faces(mesh)
    assert [faces_at(around, vertex) for vertex in range(4)] == [[0, 1], [0], [0, 1], [1]]


def test_vertices_in_one_place_count_as_one():
    zero = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, -0.0], [0, 0, 1], [1, 0, 0]])
    around = find_vertex_faces(Mesh.from_arrays(zero, [[0, 1, 2], [3, 4, 5]]))
    assert faces_at(around, 0) == faces_at(around, 3) == [0, 1]
    assert faces_at(around, 1) == faces_at(around, 5) == [0, 1]
    assert faces_at(around, 2) == [0]
    assert faces_at(around, 4) == [1]


def test_vertices_of_no_face_have_none():
    around = find_vertex_faces(Mesh.from_arrays([[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [-9, 9, 9]], [[1, 2, 3]]))
    assert [faces_at(around, vertex) for vertex in (0, 1, 4)] == [[], [0], []]


@pytest.mark.parametrize("is_soup", [False, True])
def test_every_corner_is_there_once(is_soup):
    mesh = make_shape("knot", triangles=1200)
    if is_soup:
        corners = mesh.vertices[mesh.faces].reshape(-1, 3)
        soup = Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))
        merged, around = find_vertex_faces(mesh), find_vertex_faces(soup)
        for face in range(0, 1200, 7):
            for corner in range(3):
                assert faces_at(around, soup.faces[face, corner]) == faces_at(merged, mesh.faces[face, corner])
    else:
        around = find_vertex_faces(mesh)
        for vertex in range(0, len(mesh.vertices), 5):
            assert faces_at(around, vertex) == np.flatnonzero((mesh.faces == vertex).any(axis=1)).tolist()
