"""The arrays of a scene: rows of each geometry, and the matrices of the instances."""

import numpy as np
import pytest

import clbvh
from clbvh.errors import SceneError
from clbvh.structs import PRIM_KINDS
from clbvh.trace.world.surface_arrays import lone_arrays, make_surface_arrays, move_instances, place_point, place_vector

TRIANGLE = clbvh.Mesh.from_arrays([[0, 0, 0], [4, 0, 0], [0, 2, 0]], [[0, 1, 2]])
SQUARE = clbvh.Mesh.from_arrays([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
SPHERES = clbvh.Spheres([[1, 2, 3], [5, 2, 3]], [0.5, 1])


def identities(count):
    return np.tile(np.eye(4), (count, 1, 1))


def rotations(count, generator):
    return np.linalg.qr(generator.normal(size=(count, 3, 3)))[0]


def test_rows_of_each_geometry():
    arrays = make_surface_arrays([TRIANGLE, SPHERES, SQUARE, SPHERES], np.array([2, 0]), identities(2))
    assert arrays.kind.tolist() == [PRIM_KINDS[kind] for kind in ("triangles", "spheres", "triangles", "spheres")]
    assert arrays.first_vertex.tolist() == [0, 0, 3, 0]
    assert arrays.first_face.tolist() == [0, 0, 1, 0]
    assert arrays.first_sphere.tolist() == [0, 0, 0, 2]
    np.testing.assert_array_equal(arrays.vertices[3:], SQUARE.vertices)
    np.testing.assert_array_equal(arrays.faces[1:], SQUARE.faces)
    np.testing.assert_array_equal(arrays.spheres[2:], [[1, 2, 3, 0.5], [5, 2, 3, 1]])
    np.testing.assert_array_equal(arrays.half_size, [[2, 1, 0], [2.75, 1, 1], [0.5, 0.5, 0], [2.75, 1, 1]])
    assert arrays.scale.tolist() == [TRIANGLE.scale, 0.25, SQUARE.scale, 0.25]
    assert arrays.geometry_id.tolist() == [2, 0]


def test_one_mesh_is_not_copied():
    arrays = make_surface_arrays([SPHERES, SQUARE], np.array([1]), identities(1))
    assert arrays.vertices is SQUARE.vertices
    assert arrays.faces is SQUARE.faces


@pytest.mark.parametrize("shape", [SQUARE, SPHERES], ids=["mesh", "spheres"])
def test_a_lone_shape_has_the_rows_of_its_only_instance(shape):
    lone, placed = lone_arrays(shape), make_surface_arrays([shape], np.zeros(1, int), identities(1))
    assert lone.is_lone
    assert not placed.is_lone
    for name in set(lone._fields) - {"half_size", "is_lone"}:
        obtained, expected = getattr(lone, name), getattr(placed, name)
        assert obtained.dtype == expected.dtype, name
        np.testing.assert_array_equal(obtained, expected, err_msg=name)


def test_a_scene_without_instances_and_one_without_geometries_have_no_rows():
    arrays = make_surface_arrays([SPHERES], np.empty(0, np.int32), np.empty((0, 4, 4)))
    assert arrays.linear.shape == arrays.inverse.shape == (0, 3, 3)
    assert arrays.vertices.shape == arrays.faces.shape == (0, 3)
    arrays = make_surface_arrays([], np.empty(0, np.int32), np.empty((0, 4, 4)))
    assert arrays.spheres.shape == (0, 4)
    assert arrays.origin.shape == (0, 3)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("scales", ["rows", "columns", "all"])
def test_inverses_of_stretched_and_mirrored_rotations_are_those_of_the_formula(scales, seed):
    generator = np.random.default_rng(seed)
    turns = rotations(500, generator)
    factors = 10 ** generator.uniform(-30, 30, (500, 1 if scales == "all" else 3))
    transforms = identities(500)
    if scales == "columns":
        transforms[:, :3, :3] = turns * factors[:, None, :]
        expected = turns.transpose(0, 2, 1) / factors[:, :, None]
    else:
        transforms[:, :3, :3] = turns * factors[:, :, None]
        expected = turns.transpose(0, 2, 1) / factors[:, None, :]
    arrays = make_surface_arrays([SQUARE], np.zeros(500, np.int32), transforms)
    inverse_turns = arrays.inverse / expected * turns.transpose(0, 2, 1)
    assert np.abs(inverse_turns - turns.transpose(0, 2, 1)).max() < 1e-14
    np.testing.assert_array_equal(arrays.is_mirrored, np.linalg.det(turns) < 0)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("shear", [1.0, 1e3, 1e6])
def test_products_of_sheared_matrices_and_their_inverses_are_the_identity(shear, seed):
    generator = np.random.default_rng(seed)
    transforms = identities(200)
    transforms[:, 0, 1] = shear
    transforms[:, :3, :3] = rotations(200, generator) @ transforms[:, :3, :3]
    arrays = make_surface_arrays([SQUARE], np.zeros(200, np.int32), transforms)
    # The residual of a stable inverse is a few roundings of the products that are added up.
    residual = np.abs(arrays.linear @ arrays.inverse - np.eye(3))
    assert (residual <= 1e-15 * (np.abs(arrays.linear) @ np.abs(arrays.inverse))).all()


@pytest.mark.parametrize("unit", [1e-30, 1.0, 1e30])
def test_the_world_scale_brings_an_instance_to_a_size_of_about_one(unit):
    transforms = identities(2)
    transforms[0, :3, :3] *= unit
    transforms[1, :3, :3] = np.diag([unit, 1e-9 * unit, 1e-9 * unit])
    transforms[:, :3, 3] = 1e7
    arrays = make_surface_arrays([TRIANGLE, SPHERES], np.array([0, 1]), transforms)
    sizes = arrays.world_scale * unit * [2, 2.75]
    assert (sizes >= 0.5).all()
    assert (sizes < 1).all()
    assert (np.frexp(arrays.world_scale)[0] == 0.5).all()


def test_a_mesh_of_one_point_has_a_world_scale_of_one():
    point = clbvh.Mesh.from_arrays([[1, 1, 1]], [[0, 0, 0]])
    assert make_surface_arrays([point], np.array([0]), identities(1)).world_scale.tolist() == [1]


@pytest.mark.parametrize("unit", [1e-160, 1e160])
def test_a_size_beyond_float64_is_refused(unit):
    transforms = identities(3)
    transforms[2, :3, :3] *= unit
    with pytest.raises(SceneError, match=r"instance 2 is smaller than .* or larger than"):
        make_surface_arrays([SQUARE], np.zeros(3, np.int32), transforms)


def test_points_and_vectors_are_placed_and_the_identity_changes_no_bit():
    generator = np.random.default_rng(0)
    transforms = identities(2)
    transforms[1, :3] = generator.normal(size=(3, 4))
    arrays = make_surface_arrays([SQUARE], np.zeros(2, np.int32), transforms)
    point = generator.normal(size=3)
    assert place_point(arrays, 0, *point) == tuple(point)
    assert place_vector(arrays, 0, *point) == tuple(point)
    assert place_point(arrays, 1, *point) == pytest.approx(transforms[1, :3, :3] @ point + transforms[1, :3, 3])
    assert place_vector(arrays, 1, *point) == pytest.approx(transforms[1, :3, :3] @ point)


def test_moved_instances_share_the_arrays_of_the_geometries():
    arrays = make_surface_arrays([SQUARE, TRIANGLE], np.array([1]), identities(1))
    moved = move_instances(arrays, 2 * identities(1))
    assert moved.vertices is arrays.vertices
    assert moved.linear[0, 0, 0] == 2
    assert arrays.linear[0, 0, 0] == 1
