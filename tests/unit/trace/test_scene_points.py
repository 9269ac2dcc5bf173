"""The oracle for points in scenes: distances by formula and by search, insides of unions, doubt next to surfaces."""

import numpy as np
import pytest
import trimesh

from clbvh import Mesh, Spheres, make_shape

from ...scene_points import ScenePoints, nearest_on_ellipsoid, nearest_on_triangle
from .nearest_point import expected_distance
from .scene_states import affine, flatten, make_state, random_linear

BALL = Spheres([[0, 0, 0]], 1.0)
CUBE = Mesh.from_arrays(*(lambda box: (box.vertices, box.faces))(trimesh.creation.box((2, 2, 2))), name="cube")


class TestTriangle:
    @pytest.mark.parametrize("seed", range(3))
    def test_it_is_what_trimesh_finds(self, seed):
        corners = np.random.default_rng(seed).normal(size=(300, 3, 3))
        expected = trimesh.triangles.closest_point(corners, np.zeros((300, 3)))
        found = [nearest_on_triangle(*(tuple(corner) for corner in triangle)) for triangle in corners]
        np.testing.assert_allclose(found, expected, atol=1e-12)

    def test_degenerate_ones_are_their_edges(self):
        assert nearest_on_triangle((1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 3.0, 0.0)) == (1, 0, 0)
        assert nearest_on_triangle(*[(1.0, 2.0, 3.0)] * 3) == (1, 2, 3)


def on_ellipsoid(axes, point):
    nearest = np.empty(3)
    nearest_on_ellipsoid(np.array(axes, float), np.array(point, float), nearest)
    return nearest


class TestEllipsoid:
    @pytest.mark.parametrize(
        ("axes", "point", "expected"),
        [
            ((1, 1, 1), (0, 0, 3), (0, 0, 1)),
            ((1, 1, 1), (0.3, 0, 0.4), (0.6, 0, 0.8)),
            ((3, 2, 1), (9, 0, 0), (3, 0, 0)),
            ((3, 2, 1), (0, 0, 0.5), (0, 0, 1)),
            ((3, 2, 1), (0, 0, -1e-9), (0, 0, -1)),
            ((1, 2, 3), (1, 0, 0), (1, 0, 0)),
            # On the plane across the shortest axis: x / 3 is 3 * 1 / (9 - 1), and the rest goes along that axis.
            ((3, 2, 1), (1, 0, 0), (1.125, 0, np.sqrt(1 - 0.375**2))),
            ((3, 2, 1), (0, 0, 0), (0, 0, 1)),
            # Beyond the evolute there is a nearest point in the plane.
            ((3, 2, 1), (2.9, 0, 0), (3, 0, 0)),
        ],
    )
    def test_by_formula(self, axes, point, expected):
        np.testing.assert_allclose(on_ellipsoid(axes, point), expected, atol=1e-12)

    @pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
    @pytest.mark.parametrize("seed", range(3))
    def test_no_point_of_the_surface_is_nearer(self, seed, scale):
        generator = np.random.default_rng([8, seed])
        normals = generator.normal(size=(20_000, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        for _ in range(20):
            axes = 10.0 ** generator.uniform(-2, 1, 3)
            point = generator.normal(size=3) * generator.choice([0.1, 1, 10], 3) * axes
            point[generator.random(3) < 0.2] = 0
            nearest = on_ellipsoid(axes * scale, point * scale) / scale
            assert ((nearest / axes) ** 2).sum() == pytest.approx(1, rel=1e-9)
            least = np.linalg.norm(normals * axes - point, axis=1).min()
            distance = np.linalg.norm(nearest - point)
            assert distance <= least * (1 + 1e-9)
            assert least <= distance + 0.1 * axes.max()


class TestDistance:
    @pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
    def test_a_placed_sphere_by_formula(self, scale):
        points = ScenePoints(make_state([BALL], (0, affine(np.diag([2, 1, 1]) * scale, np.array([0, 0, 9]) * scale))))
        found = points.closest_point(np.array([[0, 0, 0], [5, 0, 9], [0, 0, 8.5]]) * scale)
        np.testing.assert_allclose(found.distance / scale, [8, 3, 0.5], rtol=1e-12)
        np.testing.assert_allclose(found.point / scale, [[0, 0, 8], [2, 0, 9], [0, 0, 8]], atol=1e-12)

    @pytest.mark.parametrize("seed", range(4))
    def test_sheared_meshes_are_those_of_the_flattened_mesh(self, seed):
        generator = np.random.default_rng([9, seed])
        ball = make_shape("icosphere", triangles=80)
        placed = [(index % 2, affine(random_linear(generator), generator.normal(size=3) * 5)) for index in range(5)]
        state = make_state([ball, CUBE], *placed)
        vertices, faces, ids = flatten(state)
        points = generator.normal(size=(200, 3)) * 6
        found = ScenePoints(state).closest_point(points)
        expected = expected_distance(Mesh.from_arrays(vertices, faces), points)
        np.testing.assert_allclose(found.distance, expected, rtol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(found.point - points, axis=1), expected, rtol=1e-9)
        named = np.column_stack((found.instance_id, found.prim_id))
        assert (named[:, None] == ids).all(axis=2).any(axis=1).all()
        again = ScenePoints(state).distance_to(points, found.instance_id, found.prim_id)
        np.testing.assert_allclose(again, expected, rtol=1e-9)

    @pytest.mark.parametrize("seed", range(3))
    def test_sheared_spheres_are_those_of_fine_icospheres(self, seed):
        generator = np.random.default_rng([10, seed])
        linear = random_linear(generator)
        fine = make_shape("icosphere", triangles=20_480)
        points = generator.normal(size=(20, 3)) * 4
        one = ScenePoints(make_state([BALL], (0, affine(linear)))).closest_point(points)
        other = ScenePoints(make_state([fine], (0, affine(linear)))).closest_point(points)
        np.testing.assert_allclose(one.distance, other.distance, atol=2e-3 * np.linalg.norm(linear, 2))

    def test_at_equal_distance_the_smaller_ids_win(self):
        state = make_state([BALL], (0, affine(offset=(2, 0, 0))), (0, affine(offset=(-2, 0, 0))))
        assert ScenePoints(state).closest_point([[0, 0, 0]]).instance_id == 0
        twice = Spheres([[1, 0, 0], [0, 0, 0], [0, 0, 0]], 1.0)
        assert ScenePoints(make_state([twice], (0, affine()))).closest_point([[-3, 0, 0]]).prim_id == 1

    def test_invisible_instances_and_degenerate_triangles_do_not_count(self):
        line = Mesh.from_arrays([[0, 0, 1], [1, 0, 1], [2, 0, 1]], [[0, 1, 2]])
        state = make_state([BALL, line], (1, affine()), (0, affine(offset=(9, 0, 0)), 1), (0, affine(), 2))
        found = ScenePoints(state, mask=1).closest_point([[0, 0, 1]])
        assert (found.instance_id, found.geometry_id, found.prim_id) == (1, 0, 0)
        nothing = ScenePoints(state, mask=4).closest_point([[0, 0, 1]])
        assert (nothing.distance, nothing.instance_id, nothing.prim_id) == (np.inf, -1, -1)
        assert np.isnan(nothing.point).all()


class TestInside:
    """A cube from -1 to 1, a sheared ball around it, and another cube beside it."""

    STATE = make_state(
        [CUBE, BALL], (0, affine()), (1, affine([[3, 1, 0], [0, 3, 0], [0, 0, 3]])), (0, affine(offset=(9, 0, 0)), 2)
    )

    def test_by_formula(self):
        points = ScenePoints(self.STATE)
        where = [[0.9, 0.9, 0.9], [2, 0, 0], [9, 0, 0.5], [0, 0, 3.5], [6, 0, 0]]
        is_inside, is_decided = points.contains(where)
        assert is_inside.tolist() == [True, True, True, False, False]
        assert is_decided.all()
        assert ScenePoints(self.STATE, mask=1).contains(where)[0].tolist() == [True, True, False, False, False]

    def test_next_to_a_surface_it_is_undecided_unless_another_instance_contains_the_point(self):
        is_inside, is_decided = ScenePoints(self.STATE).contains([[1, 0, 0], [8, 0, 0], [8 - 1e-9, 0, 0], [7.9, 0, 0]])
        assert is_decided.tolist() == [True, False, False, True]
        assert is_inside[0]
        assert not is_inside[3]

    def test_signed_distances_by_formula(self):
        state = make_state([CUBE], (0, affine()), (0, affine(offset=(1.5, 0, 0))))
        distance, is_decided, slack = ScenePoints(state).signed_distance(
            [[0, 0, 0.5], [0.75, 0, 0], [0.6, 0, 0], [-3, 0, 0], [0, 0, 1]]
        )
        # In the overlap, the greater one of two.
        np.testing.assert_allclose(distance, [0.5, 0.25, 0.4, -2, 0], atol=1e-12)
        assert is_decided.tolist() == [True, True, True, True, False]
        assert (slack < 1e-4).all()

    def test_a_shell_within_a_shell_is_outside_and_a_ball_within_a_ball_is_inside(self):
        inner = CUBE.vertices / 2
        shells = Mesh.from_arrays(np.concatenate((CUBE.vertices, inner)), np.concatenate((CUBE.faces, CUBE.faces + 8)))
        balls = Spheres([[0, 0, 0], [0, 0, 0]], [1, 0.5])
        for shape, expected in ((shells, False), (balls, True)):
            is_inside, is_decided = ScenePoints(make_state([shape], (0, affine()))).contains([[0.1, 0.05, 0.02]])
            assert is_decided
            assert is_inside == expected

    def test_two_coincident_instances_contain_what_one_does(self):
        state = make_state([CUBE], (0, affine()), (0, affine()))
        assert ScenePoints(state).contains([[0.1, 0.2, 0.3], [2, 0, 0]])[0].tolist() == [True, False]

    def test_far_away(self):
        state = make_state([CUBE], (0, affine(offset=(1e7, 0, 0))), (0, affine()))
        is_inside, is_decided = ScenePoints(state).contains([[1e7 + 0.5, 0, 0], [1e7 + 1.5, 0, 0]])
        assert is_inside.tolist() == [True, False]
        assert is_decided.all()

    @pytest.mark.parametrize("seed", range(3))
    def test_any_transform(self, seed):
        generator = np.random.default_rng([11, seed])
        linear, move = random_linear(generator), generator.normal(size=3)
        local = generator.uniform(-1.5, 1.5, (300, 3))
        points = local @ linear.T + move
        for shape, expected in ((CUBE, np.abs(local).max(axis=1) < 1), (BALL, np.linalg.norm(local, axis=1) < 1)):
            is_inside, is_decided = ScenePoints(make_state([shape], (0, affine(linear, move)))).contains(points)
            assert is_decided.sum() > 290
            np.testing.assert_array_equal(is_inside[is_decided], expected[is_decided])


def test_an_empty_scene():
    points = ScenePoints(make_state([CUBE]))
    assert points.closest_point([[0, 0, 0]]).distance == np.inf
    assert points.contains([[0, 0, 0]])[0].tolist() == [False]
    assert points.signed_distance([[0, 0, 0]])[0].tolist() == [-np.inf]
