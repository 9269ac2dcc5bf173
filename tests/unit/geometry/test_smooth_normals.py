"""Normals at corners: smooth below a crease angle, sharp above it."""

import numpy as np
import pytest
import trimesh

import clbvh

BOX = trimesh.creation.box()


def slow_normals(vertices, faces, angle):
    """Return the normals by the formula, corner by corner."""
    points = np.unique(np.asarray(vertices) + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    corners = np.asarray(vertices, np.float64)[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    units = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    expected = np.zeros((len(faces), 3, 3))
    for face in range(len(faces)):
        for corner in range(3):
            total = np.zeros(3)
            for other in range(len(faces)):
                cosine = units[face] @ units[other]
                for other_corner in range(3):
                    is_same = points[faces[face][corner]] == points[faces[other][other_corner]]
                    is_near = angle == 180 or cosine > np.cos(np.radians(angle)) or other == face
                    if is_same and is_near:
                        own = corners[other][other_corner]
                        u, v = corners[other][other_corner - 2] - own, corners[other][other_corner - 1] - own
                        total += units[other] * np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
            expected[face, corner] = total / np.linalg.norm(total)
    return expected


@pytest.mark.parametrize("angle", [0, 20, 40, 90, 180])
@pytest.mark.parametrize("seed", [0, 1])
def test_normals_are_those_of_the_formula(seed, angle):
    generator = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(subdivisions=1)
    vertices = sphere.vertices + generator.normal(scale=0.15, size=sphere.vertices.shape)
    faces = sphere.faces
    if seed:  # each face has vertices of its own
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    normals = clbvh.smooth_normals_by_angle(clbvh.Mesh.from_arrays(vertices, faces), angle)
    assert normals.dtype == np.float32
    np.testing.assert_allclose(normals, slow_normals(vertices, faces, angle), atol=1e-6)


def test_a_box_is_flat_below_its_right_angles_and_round_above():
    mesh = clbvh.Mesh.from_arrays(BOX.vertices, BOX.faces)
    flat = np.repeat(BOX.face_normals[:, None], 3, axis=1)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(mesh, 89.9), flat, atol=1e-7)
    diagonal = np.sign(BOX.vertices[BOX.faces]) / np.sqrt(3)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(mesh, 90.1), diagonal, atol=1e-6)


def test_a_point_of_many_faces_has_the_normal_of_its_side():
    count = 3000
    turns = np.linspace(0, 2 * np.pi, count, endpoint=False)
    rim = np.column_stack((np.cos(turns), np.sin(turns), np.zeros(count)))
    vertices = np.concatenate((rim, [[0, 0, 1]]))
    faces = np.column_stack((np.arange(count), (np.arange(count) + 1) % count, np.full(count, count)))
    mesh = clbvh.Mesh.from_arrays(vertices, faces)
    np.testing.assert_allclose(clbvh.smooth_normals_by_angle(mesh, 180)[:, 2], [[0, 0, 1]] * count, atol=1e-5)
    # The sides of the cone slope by 45 degrees; those within 40 degrees of one lie around it evenly.
    normals = clbvh.smooth_normals_by_angle(mesh, 40)[:, 2]
    middle = turns + np.pi / count
    away = np.column_stack((np.cos(middle), np.sin(middle)))
    assert (np.einsum("ij,ij->i", normals[:, :2], away) > 0.6).all()
    assert np.degrees(np.arccos(normals[:, 2])).max() < 48


@pytest.mark.parametrize("unit", [1e-150, 1e-30, 1e30, 1e149])
def test_any_unit_gives_the_same_normals(unit):
    knot = clbvh.make_shape("knot", triangles=1000)
    scaled = clbvh.Mesh.from_arrays(knot.vertices * unit, knot.faces)
    np.testing.assert_allclose(
        clbvh.smooth_normals_by_angle(scaled, 40), clbvh.smooth_normals_by_angle(knot, 40), atol=1e-6
    )


def test_faces_without_area_neither_count_nor_have_a_normal_of_their_own():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [9, 9, 9], [9, 9, 8]]
    mesh = clbvh.Mesh.from_arrays(vertices, [[0, 1, 2], [0, 1, 3], [0, 0, 1], [4, 4, 5], [0, 2, 1]])
    normals = clbvh.smooth_normals_by_angle(mesh, 40)
    np.testing.assert_array_equal(normals[:1], [[[0, 0, 1]] * 3])
    np.testing.assert_array_equal(normals[4], [[0, 0, -1]] * 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1, atol=1e-6)
    # Opposite faces cancel each other even where all may be smoothed over.
    assert np.isfinite(clbvh.smooth_normals_by_angle(mesh, 180)).all()


@pytest.mark.parametrize("angle", [-1, 181, np.nan, "wide", None, True])
def test_a_wrong_angle_is_refused(angle):
    mesh = clbvh.make_shape("icosphere", triangles=20)
    with pytest.raises(clbvh.ConfigError, match="crease angle must be 0 to 180"):
        clbvh.smooth_normals_by_angle(mesh, angle)
