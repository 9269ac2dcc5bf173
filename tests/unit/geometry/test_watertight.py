import numpy as np
import pytest
import trimesh

from clbvh import Mesh
from clbvh.geometry import mesh as mesh_module
from clbvh.geometry.topology import is_closed

SPHERE = trimesh.creation.icosphere(subdivisions=3)
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def is_watertight(vertices, faces):
    return Mesh.from_arrays(vertices, faces).is_watertight


def test_a_sphere_is_closed():
    assert is_watertight(SPHERE.vertices, SPHERE.faces)


@pytest.mark.parametrize("missing", [0, 100, len(SPHERE.faces) - 1])
def test_a_sphere_without_one_triangle_is_open(missing):
    assert not is_watertight(SPHERE.vertices, np.delete(SPHERE.faces, missing, axis=0))


def test_the_orientation_does_not_matter():
    faces = SPHERE.faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert is_watertight(SPHERE.vertices, faces)


def test_corners_listed_for_each_triangle_count_as_one_vertex():
    corners = SPHERE.vertices[SPHERE.faces].reshape(-1, 3)
    assert is_watertight(corners, np.arange(len(corners)).reshape(-1, 3))


def test_the_sign_of_a_zero_does_not_matter():
    corners = CORNERS[TETRAHEDRON] - 0.5
    corners[corners < 0] = 0.0
    corners[:2][corners[:2] == 0] = -0.0
    assert is_watertight(corners.reshape(-1, 3), np.arange(12).reshape(-1, 3))


def test_a_doubled_triangle_is_closed_and_a_tripled_one_open():
    assert is_watertight(CORNERS, [[0, 1, 2], [0, 2, 1]])
    assert not is_watertight(CORNERS, [[0, 1, 2], [0, 2, 1], [1, 2, 0]])


def test_two_bodies_that_share_an_edge_are_closed():
    # Four triangles meet at the edge between vertices 0 and 1.
    other = np.concatenate([CORNERS, [[0, -1, 0], [0, 0, -1]]])
    second = np.array([0, 1, 4, 5])[TETRAHEDRON]
    assert is_watertight(other, np.concatenate([TETRAHEDRON, second]))


@pytest.mark.parametrize("extra", [[0, 0, 1], [2, 2, 2]])
def test_a_triangle_with_equal_corners_changes_nothing(extra):
    assert is_watertight(CORNERS, [*TETRAHEDRON, extra])
    assert not is_watertight(CORNERS, [*TETRAHEDRON[1:], extra])


def test_one_triangle_is_open():
    assert not is_watertight(CORNERS, [[0, 1, 2]])


@pytest.mark.parametrize("seed", range(5))
def test_random_bodies_are_judged_as_counted_edges_say(seed):
    rng = np.random.default_rng(seed)
    faces = np.array([face for face in rng.integers(0, 12, (rng.integers(4, 60), 3)) if len(set(face)) == 3])
    # Half of them closed: every triangle of a random set becomes the four of a tetrahedron over a new vertex.
    for closed in (False, True):
        if closed:
            faces = np.concatenate([[[a, b, c], [a, b, 12], [b, c, 12], [c, a, 12]] for a, b, c in faces])
        edges, counts = np.unique(
            np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True
        )
        assert len(edges)
        assert is_watertight(rng.normal(size=(13, 3)), faces) == bool((counts % 2 == 0).all())


@pytest.mark.parametrize("exponent", [-100, 100])
def test_size_does_not_matter(exponent):
    assert is_watertight(SPHERE.vertices * 10.0**exponent, SPHERE.faces)


class TestMovedMeshes:
    """Faces that share vertices along all edges stay closed however the vertices move, and are not tested again."""

    @pytest.fixture
    def tested(self, monkeypatch):
        """The numbers of faces whose edges have been counted."""
        tested = []
        monkeypatch.setattr(mesh_module, "is_closed", lambda faces: tested.append(len(faces)) or is_closed(faces))
        return tested

    def test_joined_faces_are_not_tested_again(self, tested):
        mesh = Mesh.from_arrays(SPHERE.vertices, SPHERE.faces)
        assert mesh.is_watertight
        tested.clear()
        for factor in (2, 0, [1, 0, 1], 1e9):
            mesh = mesh.with_vertices(SPHERE.vertices * factor)
            assert mesh.is_watertight
        assert tested == []

    def test_joined_faces_that_were_not_tested_yet_are_tested_once(self, tested):
        mesh = Mesh.from_arrays(SPHERE.vertices, SPHERE.faces).with_vertices(SPHERE.vertices * 2)
        assert tested == []
        assert mesh.is_watertight
        assert tested == [len(SPHERE.faces)]
        assert mesh.with_vertices(SPHERE.vertices).is_watertight
        assert len(tested) == 1

    @pytest.mark.parametrize("missing", [0, 5])
    def test_joined_faces_with_a_hole_may_be_closed_by_moving(self, missing):
        mesh = Mesh.from_arrays(SPHERE.vertices, np.delete(SPHERE.faces, missing, axis=0))
        assert not mesh.is_watertight
        closed = SPHERE.vertices.copy()
        closed[SPHERE.faces[missing]] = closed[SPHERE.faces[missing, 0]]
        assert mesh.with_vertices(closed).is_watertight
        assert not mesh.with_vertices(closed).with_vertices(SPHERE.vertices).is_watertight

    def test_corners_listed_for_each_triangle_are_tested_again(self):
        corners = SPHERE.vertices[SPHERE.faces].reshape(-1, 3)
        mesh = Mesh.from_arrays(corners, np.arange(len(corners)).reshape(-1, 3))
        assert mesh.is_watertight
        torn = corners.copy()
        torn[0] *= 1.5
        assert not mesh.with_vertices(torn).is_watertight
        assert mesh.with_vertices(torn).with_vertices(corners).is_watertight

    def test_faces_with_the_same_vertex_twice(self):
        faces = [*TETRAHEDRON.tolist(), [0, 0, 1], [2, 2, 2]]
        mesh = Mesh.from_arrays(CORNERS, faces)
        assert mesh.is_watertight
        assert mesh.with_vertices(CORNERS * [1, 2, 0]).is_watertight
        assert not Mesh.from_arrays(CORNERS, [*faces, [0, 1, 2]]).is_watertight
