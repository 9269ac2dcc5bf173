"""The mesh: checks, re-basing, degenerate triangles."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clbvh import Mesh
from clbvh.errors import MeshError
from clbvh.geometry import mesh as mesh_module

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def test_vertices_are_kept_and_once_more_around_zero_and_about_1_in_size():
    vertices = [[10, 20, 30], [14, 20, 30], [10, 26, 38]]
    mesh = Mesh.from_arrays(vertices, [[0, 1, 2]])
    assert mesh.vertices.tolist() == vertices
    assert (mesh.origin.tolist(), mesh.scale) == ([12, 23, 34], 0.125)
    assert (mesh.local_vertices * 8).tolist() == [[-2, -3, -4], [2, -3, -4], [-2, 3, 4]]
    assert (mesh.vertices.dtype, mesh.local_vertices.dtype) == (np.float64, np.float32)
    assert (mesh.faces.dtype, mesh.origin.dtype) == (np.int32, np.float64)
    assert (mesh.to_local(vertices) == mesh.local_vertices).all()


@pytest.mark.parametrize("exponent", [-495, -149, -52, -1, 0, 1, 23, 300, 495])
def test_local_coordinates_have_the_same_bits_in_every_unit(exponent):
    vertices = np.random.default_rng(0).normal(size=(50, 3))
    mesh, scaled = (Mesh.from_arrays(vertices * unit, [[0, 1, 2]]) for unit in (1, 2.0**exponent))
    assert scaled.local_vertices.tobytes() == mesh.local_vertices.tobytes()
    assert scaled.scale == mesh.scale * 2.0**-exponent
    half = np.abs(mesh.local_vertices).max()
    assert 0.5 <= half <= 1


def test_a_mesh_without_extent_is_not_scaled():
    mesh = Mesh.from_arrays(np.full((3, 3), 7.5), [[0, 1, 2]])
    assert (mesh.scale, mesh.local_vertices.any()) == (1, False)


def test_survey_coordinates_keep_their_millimetres():
    corner = np.array([5.0e6, 6.0e6, 300.0])
    mesh = Mesh.from_arrays(corner + np.array(TRIANGLE) * 1e-3, [[0, 1, 2]])
    edges = np.diff(mesh.local_vertices[[0, 1]] / mesh.scale, axis=0)
    assert edges[0] == pytest.approx([1e-3, 0, 0], abs=1e-8)


@pytest.mark.parametrize("dtypes", [(np.float32, np.int64), (np.float64, np.int32)])
def test_arrays_of_the_caller_are_not_changed_nor_kept(dtypes):
    vertices, faces = np.array(TRIANGLE, dtypes[0]), np.array([[0, 1, 2]], dtypes[1])
    mesh = Mesh.from_arrays(vertices, faces)
    vertices += 7
    faces += 7
    assert mesh.vertices.tolist() == TRIANGLE
    assert mesh.faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.longdouble, np.int8, np.uint32])
def test_vertices_may_have_any_number_type(dtype):
    assert Mesh.from_arrays(np.array(TRIANGLE, dtype=dtype), [[0, 1, 2]]).vertices.tolist() == TRIANGLE


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.uint64, np.int64])
def test_faces_may_have_any_whole_number_type(dtype):
    assert Mesh.from_arrays(TRIANGLE, np.array([[0, 1, 2]], dtype=dtype)).faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        pytest.param(np.zeros((3, 2)), [[0, 1, 2]], r"shape \(V, 3\), not \(3, 2\)", id="flat-vertices"),
        pytest.param(np.zeros((0, 3)), [[0, 1, 2]], "no vertices", id="no-vertices"),
        pytest.param([["a", "b", "c"]], [[0, 0, 0]], "must be numbers", id="text"),
        pytest.param(TRIANGLE, np.zeros((0, 3), int), "no faces", id="no-faces"),
        pytest.param(TRIANGLE, [[0, 1, 2, 2]], r"shape \(F, 3\), not \(1, 4\)", id="quads"),
        pytest.param(TRIANGLE, [[0.0, 1.0, 2.0]], "must be integers", id="float-faces"),
        pytest.param(TRIANGLE, [[0, 1, 2], [0, 1, 3]], r"face 1 refers to vertex 3, .*\(0 to 2\)", id="index-too-high"),
        pytest.param(TRIANGLE, [[0, 1, 2], [0, -1, 2]], "face 1 refers to vertex -1", id="index-negative"),
        pytest.param(
            [*TRIANGLE, [0, np.nan, 0]], [[0, 1, 2]], "vertex 3 has a coordinate .*not finite: y = nan", id="nan"
        ),
        pytest.param([[0, 0, -np.inf], *TRIANGLE], [[0, 1, 2]], "vertex 0 .*: z = -inf", id="infinite"),
        pytest.param(np.array(TRIANGLE) * 1e160, [[0, 1, 2]], "5e.159 units wide .*in another unit", id="too-wide"),
        pytest.param(np.array(TRIANGLE) * 1e-160, [[0, 1, 2]], "less than 3e-151 or more than 3e.150", id="too-small"),
        pytest.param(
            [[-1.5e308, 0, 0], [1.5e308, 0, 0], [0, 1, 0]], [[0, 1, 2]], "1.5e.308 units wide", id="wider-than-float64"
        ),
    ],
)
def test_bad_arrays_are_refused_by_name(vertices, faces, message):
    with pytest.raises(MeshError, match=message) as caught:
        Mesh.from_arrays(vertices, faces, name="thing")
    assert str(caught.value).startswith("thing: ")


def test_degenerate_triangles_are_kept_and_counted():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [3, 0, 0], [0.1, 0.1, 0.1]]
    faces = [[0, 1, 2], [0, 0, 0], [0, 1, 3], [0, 1, 4], [2, 2, 1]]
    mesh = Mesh.from_arrays(vertices, faces)
    assert mesh.degenerate_faces.tolist() == [False, True, True, False, True]
    assert (mesh.degenerate_count, mesh.face_count) == (3, 5)


def test_degenerate_triangles_are_found_in_every_chunk(monkeypatch):
    monkeypatch.setattr(mesh_module, "_CHUNK_FACES", 4)
    faces = np.tile([[0, 1, 2]], (11, 1))
    faces[[3, 4, 10]] = [0, 1, 1]
    assert np.flatnonzero(Mesh.from_arrays(TRIANGLE, faces).degenerate_faces).tolist() == [3, 4, 10]


def test_repr_says_what_it_is():
    assert repr(Mesh.from_arrays(TRIANGLE, [[0, 1, 2]], name="leaf")) == "Mesh('leaf', vertices=3, faces=1)"


@pytest.mark.parametrize("count", [3, 511, 512, 513, 1024, 1500])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_box_is_right_wherever_the_outermost_vertex_is(count, dtype):
    for place in {0, 1, count // 2, count - 1}:
        vertices = np.zeros((count, 3), dtype)
        vertices[place] = [-2, 4, 6]
        assert Mesh.from_arrays(vertices, [[0, 1, 2]]).origin.tolist() == [-1, 2, 3]


def test_vertices_of_every_second_row_make_the_same_mesh():
    wide = np.random.default_rng(0).random((1200, 6))
    strided, plain = wide[::2, 1::2], wide[::2, 1::2].copy()
    assert (Mesh.from_arrays(strided, [[0, 1, 2]]).vertices == Mesh.from_arrays(plain, [[0, 1, 2]]).vertices).all()


def test_moved_vertices_get_local_coordinates_of_their_own_and_share_the_faces():
    mesh = Mesh.from_arrays(TRIANGLE, [[0, 2, 1]], name="thing")
    moved = mesh.with_vertices(np.array(TRIANGLE) * 2 + 1e6)
    assert moved.origin.tolist() == [1e6 + 1, 1e6 + 1, 1e6]
    assert (moved.local_vertices / moved.scale).tolist() == [[-1, -1, 0], [1, -1, 0], [-1, 1, 0]]
    assert (moved.faces is mesh.faces, moved.name) == (True, "thing")
    assert mesh.origin.tolist() == [0.5, 0.5, 0]


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        pytest.param(TRIANGLE[:2], "2 vertices cannot replace the mesh's 3", id="fewer"),
        pytest.param([*TRIANGLE, [0, 0, 0]], "4 vertices cannot replace the mesh's 3", id="more"),
        pytest.param(np.zeros((3, 2)), r"shape \(V, 3\), not \(3, 2\)", id="flat"),
        pytest.param([[0, 0, 0], [1, np.nan, 0], [0, 1, 0]], "vertex 1 .*not finite: y = nan", id="nan"),
        pytest.param([[0, 0, np.inf], [1, 0, 0], [0, 1, 0]], "vertex 0 .*not finite: z = inf", id="infinite"),
        pytest.param(np.array(TRIANGLE) * 1e160, "give it in another unit", id="too-wide"),
    ],
)
def test_vertices_that_cannot_replace_others_are_refused(vertices, message):
    with pytest.raises(MeshError, match=message) as caught:
        Mesh.from_arrays(TRIANGLE, [[0, 1, 2]], name="thing").with_vertices(vertices)
    assert str(caught.value).startswith("thing: ")


def test_the_fingerprint_stands_for_what_determines_a_tree():
    vertices, faces = np.array(TRIANGLE), np.array([[0, 1, 2]])
    mesh = Mesh.from_arrays(vertices, faces, name="thing")
    assert len(mesh.fingerprint) == 32
    # Neither the name, nor the place, nor the unit.
    assert Mesh.from_arrays(vertices * 4 + 16, faces, name="other").fingerprint == mesh.fingerprint
    others = [
        Mesh.from_arrays(vertices * [1, 1 + 1e-6, 1], faces),
        Mesh.from_arrays(vertices, faces[:, ::-1]),
        # The same bytes in a row, cut elsewhere.
        dataclasses.replace(
            mesh,
            local_vertices=mesh.local_vertices[:2],
            faces=np.concatenate([mesh.local_vertices[2:].view(np.int32), mesh.faces]),
        ),
    ]
    assert len({mesh.fingerprint, *(other.fingerprint for other in others)}) == 4


def test_a_signalling_nan_is_refused_without_a_warning():
    vertices = np.array(TRIANGLE, np.float32)
    vertices.view(np.uint32)[2, 1] = 0x7FA00000
    with pytest.raises(MeshError, match=r"vertex 2 .*not finite: y = nan"):
        Mesh.from_arrays(vertices, [[0, 1, 2]])
