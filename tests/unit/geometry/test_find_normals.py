"""Which normals a picture uses, and faces that are flat beside smooth ones."""

import numpy as np
import trimesh

import clbvh
from clbvh.geometry.appearance.appearance import find_flat_normals
from clbvh.geometry.smooth_normals import flatten

KNOT = clbvh.make_shape("knot", triangles=500)


def test_solids_stay_flat_and_balls_become_smooth_by_the_default_angle():
    box = trimesh.creation.box()
    flat = clbvh.smooth_normals_by_angle(clbvh.Mesh.from_arrays(box.vertices, box.faces))
    np.testing.assert_allclose(flat, np.repeat(box.face_normals[:, None], 3, axis=1), atol=1e-6)
    ball = trimesh.creation.icosphere(subdivisions=3)
    smooth = clbvh.smooth_normals_by_angle(clbvh.Mesh.from_arrays(ball.vertices, ball.faces))
    np.testing.assert_allclose(smooth, ball.vertices[ball.faces], atol=0.01)


def test_flat_faces_keep_their_normals_beside_smooth_ones():
    chosen = np.arange(KNOT.face_count) % 3 == 0
    looks = clbvh.Appearance(materials=[clbvh.Material("kept")])
    mesh = clbvh.Mesh.from_arrays(KNOT.vertices, KNOT.faces, appearance=looks)
    flattened = flatten(mesh, chosen)
    assert flattened.materials == looks.materials
    np.testing.assert_array_equal(flattened.normals[~chosen], clbvh.smooth_normals_by_angle(KNOT)[~chosen])
    np.testing.assert_allclose(flattened.normals[chosen], clbvh.smooth_normals_by_angle(KNOT, 0)[chosen], atol=1e-6)


def test_flat_normals_of_any_size():
    for unit in (1e-200, 1e-30, 1.0, 1e200):
        corners = np.array([[[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[1, 1, 1]] * 3]) * unit
        np.testing.assert_array_equal(find_flat_normals(corners), [[0, 0, 1]] * 2)
    assert find_flat_normals(np.zeros((0, 3, 3))).shape == (0, 3)
    np.testing.assert_allclose(
        find_flat_normals(np.array([[[0, 0, 0], [0, 0, 1e-9], [0, 1, 0]]])), [[-1, 0, 0]], atol=1e-7
    )
