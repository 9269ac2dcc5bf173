"""The oracle for scenes: right answers by formula pass, each kind of wrong answer is found, and doubt is admitted."""

from types import SimpleNamespace

import numpy as np
import pytest

from clbvh import Mesh, Spheres, make_shape
from clbvh.trace.check.instances import Tolerance, find_instances, world_radius
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference

from ...all_hits_reference import find_wrong_crossings
from .scene_states import affine, make_state, random_linear, turn

SQUARE = Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])
BALL = Spheres([[0, 0, 0]], 1.0)
SHEAR = np.array([[1, 0.5, 0], [0, 1, 0.25], [0, 0, 1]])


def hit(t, instance, geometry, prim, u, v):
    fields = {"t": t, "instance_id": instance, "geometry_id": geometry, "prim_id": prim, "u": u, "v": v}
    return SimpleNamespace(**{name: np.atleast_1d(value) for name, value in fields.items()})


MISS = hit(np.inf, -1, -1, -1, 0.0, 0.0)


def reasons(state, ray, hits, **limits):
    return [found.reason for found in Reference(state).find_differences(Rays.make(*ray, **limits), hits)]


class TestTriangles:
    """A ray down at (0.5, 0.25): in the face 0, with u = 0.125 and v = 0.625."""

    STATE = make_state([SQUARE], (0, affine()), (0, affine(offset=(0, 0, -1))))
    DOWN = ([[0.5, 0.25, 2]], [[0, 0, -1]])
    RIGHT = hit(2.0, 0, 0, 0, 0.125, 0.625)

    def test_the_formula_is_right(self):
        assert reasons(self.STATE, self.DOWN, self.RIGHT) == []
        found = Reference(self.STATE).closest_hit(Rays.make(*self.DOWN))
        assert (found.t, found.instance_id, found.geometry_id, found.prim_id) == (2.0, 0, 0, 0)
        assert found.is_decided

    @pytest.mark.parametrize(
        ("wrong", "reason"),
        {
            "missed": (MISS, "a primitive is surely hit"),
            "the-one-behind": (hit(3.0, 1, 0, 0, 0.125, 0.625), "another primitive is surely hit before it"),
            "another-face": (hit(2.0, 0, 0, 1, 0.125, 0.625), "the ray does not cross this primitive at this t"),
            "t": (hit(2.0001, 0, 0, 0, 0.125, 0.625), "the ray does not cross this primitive at this t"),
            "t-nan": (hit(np.nan, 0, 0, 0, 0.125, 0.625), "the ray does not cross this primitive at this t"),
            "u": (hit(2.0, 0, 0, 0, 0.1251, 0.625), "u and v name a point"),
            "u-nan": (hit(2.0, 0, 0, 0, np.nan, 0.625), "u and v name a point"),
            "u-outside": (hit(2.0, 0, 0, 0, -0.125, 0.625), "u and v name a point"),
            "geometry": (hit(2.0, 0, 1, 0, 0.125, 0.625), "this is not the geometry of the instance"),
            "no-instance": (hit(2.0, 7, 0, 0, 0.125, 0.625), "the ray does not cross this primitive at this t"),
        }.values(),
        ids=str,
    )
    def test_each_kind_of_wrong_answer_is_found(self, wrong, reason):
        (found,) = reasons(self.STATE, self.DOWN, wrong)
        assert found.startswith(reason)

    def test_a_miss_has_no_ids(self):
        away = (self.DOWN[0], [[0, 0, 1]])
        assert reasons(self.STATE, away, MISS) == []
        for wrong in (hit(np.inf, 0, -1, -1, 0, 0), hit(np.inf, -1, 0, -1, 0, 0), hit(5.0, -1, -1, -1, 0, 0)):
            assert reasons(self.STATE, away, wrong) == ["a miss has no t and no ids"]

    def test_a_difference_is_one_sentence(self):
        (found,) = Reference(self.STATE).find_differences(Rays.make(*self.DOWN), MISS)
        assert str(found) == (
            "ray 0: obtained t = inf on primitive -1 of instance -1, expected t = 2 on primitive 0 of instance 0: "
            "a primitive is surely hit"
        )

    def test_near_an_edge_it_cannot_be_decided(self):
        for beside, decided in ((1e-7, False), (-1e-7, False), (1e-3, True), (-1e-3, True)):
            rays = Rays.make([[1 + beside, 0.25, 2]], [[0, 0, -1]])
            found = Reference(self.STATE).closest_hit(rays)
            assert found.is_decided[0] == decided, beside
            assert found.prim_id[0] >= 0 if beside == -1e-3 else True
            assert len(Reference(self.STATE).find_differences(rays, MISS)) == (beside == -1e-3)

    def test_limits(self):
        reference = Reference(self.STATE)
        for limits, expected, decided in (
            ({"t_min": 2.5}, 1, True), ({"t_max": 1.5}, -1, True), ({"t_min": 2.5, "t_max": 2.75}, -1, True),
            ({"t_max": 2.0}, -1, False), ({"t_min": 2.0}, 1, False),
        ):  # fmt: skip
            found = reference.closest_hit(Rays.make(*self.DOWN, **limits))
            assert (found.instance_id[0], found.is_decided[0]) == (expected, decided), limits

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
    @pytest.mark.parametrize("offset", [0.0, 1e7])
    def test_any_transform_against_a_linear_system(self, seed, scale, offset):
        generator = np.random.default_rng(seed)
        linear = random_linear(generator) * scale
        move = generator.normal(size=3) * offset * scale
        state = make_state([SQUARE], (0, affine(linear, move)))
        u, v = generator.dirichlet([2, 2, 2], 50).T[:2]
        a, b, c = SQUARE.vertices[SQUARE.faces[0]]
        points = (a + u[:, None] * (b - a) + v[:, None] * (c - a)) @ linear.T + move
        t = generator.uniform(0.5, 2, 50)
        directions = generator.normal(size=(50, 3)) * scale
        rays = Rays.make(points - t[:, None] * directions, directions)
        found = Reference(state).closest_hit(rays)
        assert found.is_decided.sum() > 40
        assert (found.prim_id[found.is_decided] == 0).all()
        np.testing.assert_allclose(found.t[found.is_decided], t[found.is_decided], rtol=1e-6)
        hits = hit(t, np.zeros(50, int), np.zeros(50, int), np.zeros(50, int), u, v)
        assert Reference(state).find_differences(rays, hits) == []
        hits.u = u + 0.01
        assert len(Reference(state).find_differences(rays, hits)) == 50


class TestTies:
    def test_of_coincident_instances_the_first_wins(self):
        state = make_state([SQUARE], (0, affine(SHEAR)), (0, affine(SHEAR)), (0, affine(SHEAR), 2))
        ray = ([[0.5, 0.125, 2]], [[0, 0, -1]])
        found = Reference(state).closest_hit(Rays.make(*ray))
        assert found.is_decided
        assert found.instance_id == 0
        u, v = 0.15625, 0.5625
        assert reasons(state, ray, hit(2.0, 0, 0, 0, u, v)) == []
        assert reasons(state, ray, hit(2.0, 1, 0, 0, u, v)) == ["an equal primitive in the same place has smaller ids"]
        # To a ray that does not see the first two, the third is the only one.
        assert reasons(state, ray, hit(2.0, 2, 0, 0, u, v), mask=0) == [
            "the ray does not cross this primitive at this t"
        ]
        masked = make_state([SQUARE], (0, affine(SHEAR), 1), (0, affine(SHEAR), 1), (0, affine(SHEAR), 2))
        assert reasons(masked, ray, hit(2.0, 2, 0, 0, u, v), mask=2) == []

    def test_of_repeated_primitives_the_first_wins(self):
        twice = Mesh.from_arrays(SQUARE.vertices, np.concatenate((SQUARE.faces, SQUARE.faces)))
        state = make_state([twice], (0, affine()))
        ray = ([[0.5, 0.25, 2]], [[0, 0, -1]])
        assert reasons(state, ray, hit(2.0, 0, 0, 0, 0.125, 0.625)) == []
        assert reasons(state, ray, hit(2.0, 0, 0, 2, 0.125, 0.625)) == [
            "an equal primitive in the same place has smaller ids"
        ]

    def test_instances_that_only_touch_are_undecided(self):
        state = make_state([SQUARE], (0, affine()), (0, affine((1, 1, 2))))
        ray = ([[0.5, 0.25, 2]], [[0, 0, -1]])
        assert not Reference(state).closest_hit(Rays.make(*ray)).is_decided
        for instance in (0, 1):
            assert reasons(state, ray, hit(2.0, instance, 0, 0, 0.125, 0.625)) == []


def all_hits(*rows):
    """Intersections (t, instance, prim, u, v) of one ray; the geometry's id is 0."""
    t, instance, prim, u, v = np.array(rows, np.float64).reshape(-1, 5).T
    hits = hit(t, instance.astype(int), np.zeros(len(t), int), prim.astype(int), u, v)
    hits.offsets = np.array([0, len(t)])
    return hits


class TestAllCrossings:
    """Through three squares, two of which coincide."""

    STATE = make_state([SQUARE], (0, affine(offset=(0, 0, 1))), (0, affine()), (0, affine(offset=(0, 0, 1))))
    RAY = ([[0.5, 0.25, 2]], [[0, 0, -1]])
    ROWS = ((1, 0, 0, 0.125, 0.625), (1, 2, 0, 0.125, 0.625), (2, 1, 0, 0.125, 0.625))

    def wrong(self, *rows):
        return find_wrong_crossings(Reference(self.STATE), Rays.make(*self.RAY), all_hits(*rows)).tolist()

    def test_the_formula_is_right(self):
        assert self.wrong(*self.ROWS) == []
        assert Reference(self.STATE).count_range(Rays.make(*self.RAY)) == (3, 3)

    @pytest.mark.parametrize("missing", range(3))
    def test_a_missing_one_is_found(self, missing):
        assert self.wrong(*(row for index, row in enumerate(self.ROWS) if index != missing)) == [0]

    def test_the_wrong_order_is_found(self):
        first, second, third = self.ROWS
        assert self.wrong(second, first, third) == [0]
        assert self.wrong(first, third, second) == [0]
        # Not even with a t that fits.
        assert self.wrong(first, third, (2, *second[1:])) == [0]

    def test_one_too_many_is_found(self):
        assert self.wrong(*self.ROWS, self.ROWS[-1]) == [0]
        assert self.wrong(*self.ROWS, (2, 1, 1, 0.125, 0.625)) == [0]

    def test_wrong_coordinates_are_found(self):
        assert self.wrong(*self.ROWS[:2], (2, 1, 0, 0.125, 0.6)) == [0]
        assert self.wrong(*self.ROWS[:2], (2.0001, 1, 0, 0.125, 0.625)) == [0]

    def test_the_twin_of_one_at_an_edge_is_there_or_both_are_not(self):
        reference = Reference(self.STATE)
        rays = Rays.make([[1.0, 0.25, 2]], [[0, 0, -1]])
        first, second, third = ((t, instance, prim, 0.375, 0.625) for t, instance, prim, _, _ in self.ROWS)
        for rows, expected in (((first, second, third), []), ((first, second), []), ((), []), ((first, third), [0])):
            assert find_wrong_crossings(reference, rays, all_hits(*rows)).tolist() == expected, rows


class TestSpheres:
    def test_both_crossings_by_formula(self):
        state = make_state([BALL], (0, affine((2, 1, 1), (0, 0, 5))))
        reference = Reference(state)
        rays = Rays.make([[-4, 0, 5], [0, 0, 5], [4, 0, 5], [0, 0, 0]], [[2, 0, 0], [0, 1, 0], [2, 0, 0], [0, 0, 1]])
        assert [part.tolist() for part in reference.count_range(rays)] == [[2, 1, 0, 2], [2, 1, 0, 2]]
        found = reference.intersections(rays)
        np.testing.assert_allclose(found.t, [1, 3, 1, 4, 6], rtol=1e-12)
        assert found.side.tolist() == [-1, 1, 1, -1, 1]
        np.testing.assert_allclose(reference.closest_hit(rays).t, [1, 1, np.inf, 4], rtol=1e-12)

    def test_a_tangent_is_undecided(self):
        reference = Reference(make_state([BALL], (0, affine())))
        for beside, least, most in ((1 - 1e-7, 0, 2), (1 + 1e-7, 0, 2), (1 - 1e-4, 2, 2), (1 + 1e-4, 0, 0)):
            counts = reference.count_range(Rays.make([[beside, 0, -3]], [[0, 0, 1]]))
            assert counts == (least, most), beside

    def test_near_a_tangent_t_may_be_anywhere_on_the_chord(self):
        reference = Reference(make_state([BALL], (0, affine())))
        found = reference.intersections(Rays.make([[1 - 1e-6, 0, -3]], [[0, 0, 1]]))
        # Half of it is the root of 2e-6.
        assert (found.t_low <= 3).all()
        assert (found.t_high >= 3).all()
        assert found.t_low[0] < 3 - 1.4e-3
        assert found.t_high[1] > 3 + 1.4e-3
        assert (abs(found.t - 3) < 1.5e-3).all()

    def test_u_and_v_are_angles(self):
        state = make_state([Spheres([[1, 0, 0], [9, 9, 9]], [0.5, 0.1])], (0, affine((1, 2, 1))))
        ray = ([[1, -3, 0]], [[0, 1, 0]])
        assert reasons(state, ray, hit(2.0, 0, 0, 0, 0.75, 0.5)) == []
        for u, v in ((0.25, 0.5), (0.7501, 0.5), (0.75, 0.5001), (1.75, 0.5)):
            assert len(reasons(state, ray, hit(2.0, 0, 0, 0, u, v))) == 1

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
    def test_any_transform_against_the_quadratic_equation(self, seed, scale):
        generator = np.random.default_rng([31, seed])
        linear = random_linear(generator) * scale
        move = generator.normal(size=3) * scale
        state = make_state([BALL], (0, affine(linear, move)))
        inside = generator.normal(size=(40, 3))
        inside *= 0.9 * generator.uniform(size=(40, 1)) / np.linalg.norm(inside, axis=1, keepdims=True)
        directions = generator.normal(size=(40, 3)) * scale
        origins = inside @ linear.T + move - 3 * directions
        o, d = ((np.linalg.inv(linear) @ values.T).T for values in (origins - move, directions))
        a, b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1
        root = np.sqrt(b * b - a * c)
        found = Reference(state).intersections(Rays.make(origins, directions))
        for side, t in ((-1, (-b - root) / a), (1, (-b + root) / a)):
            seen = found.side == side
            ray = found.ray_id[seen]
            np.testing.assert_allclose(found.t[seen], t[ray], rtol=1e-9, atol=1e-9)
            assert set(np.flatnonzero(t > 1e-3)) <= set(ray)


class TestTheBlur:
    def test_it_grows_with_the_distance_only_until_the_ray_is_advanced(self):
        state = make_state([SQUARE], (0, affine()))
        widths = []
        for height in (1.0, 10.0, 100.0, 1000.0):
            found = Reference(state).intersections(Rays.make([[0.5, 0.25, height]], [[0, 0, -1]]))
            widths.append(float(found.t_high[0] - found.t_low[0]))
        assert widths[0] < widths[1] < widths[2]
        assert widths[3] == pytest.approx(widths[2], rel=1e-4)

    def test_a_scale_along_axes_does_not_matter_and_a_shear_does(self):
        growths = [
            find_instances(make_state([SQUARE], (0, affine(linear))))[0].growth
            for linear in ((1, 1, 1), (1, 1e-3, 1e3), SHEAR, turn(2, 0.5))
        ]
        assert growths[:2] == [1, 1]
        assert 1.5 < growths[2] < 3
        assert 1.5 < growths[3] < 3

    def test_it_is_a_parameter(self):
        state = make_state([SQUARE], (0, affine()))
        rays = Rays.make([[1 - 1e-3, 0.25, 2]], [[0, 0, -1]])
        assert Reference(state).closest_hit(rays).is_decided
        assert not Reference(state, Tolerance(entering=2.0**-8)).closest_hit(rays).is_decided

    def test_far_away_instances_are_compared_in_float32(self):
        far = (0, 0, -1e7)
        state = make_state([SQUARE], (0, affine(offset=far)), (0, affine(offset=(0, 0, -1e7 - 0.5))), (0, affine()))
        down = ([[0.5, 0.25, -3]], [[0, 0, -1]])
        assert not Reference(state).closest_hit(Rays.make(*down)).is_decided
        # One of them alone is as certain as one here.
        found = Reference(state).intersections(Rays.make(*down))
        assert (found.t_high - found.t_low < 4e-4).all()


def test_an_empty_scene_has_no_hits():
    state = make_state([SQUARE])
    rays = Rays.make([[0, 0, 1]], [[0, 0, -1]])
    assert Reference(state).closest_hit(rays).prim_id == -1
    assert Reference(state).find_differences(rays, MISS) == []
    assert len(find_wrong_crossings(Reference(state), rays, all_hits())) == 0


def test_a_placed_icosphere_agrees_with_its_flattened_mesh():
    generator = np.random.default_rng(3)
    linear, move = random_linear(generator), np.array([3.0, -2.0, 1.0])
    ball = make_shape("icosphere", triangles=320)
    placed = make_state([ball], (0, affine(linear, move)))
    flat = make_state([Mesh.from_arrays(ball.vertices @ linear.T + move, ball.faces)], (0, affine()))
    targets = move + generator.normal(size=(500, 3)) @ linear.T / 2
    origins = move + generator.normal(size=(500, 3)) * 4
    rays = Rays.make(origins, targets - origins)
    one, other = Reference(placed).closest_hit(rays), Reference(flat).closest_hit(rays)
    both = one.is_decided & other.is_decided
    assert both.sum() > 450
    np.testing.assert_array_equal(one.prim_id[both], other.prim_id[both])
    np.testing.assert_allclose(one.t[both], other.t[both], rtol=1e-5, atol=1e-5)
    assert (one.prim_id >= 0).sum() > 100


def test_the_size_of_a_scene_is_that_of_all_instances():
    state = make_state([BALL], (0, affine(offset=(-3, 0, 0))), (0, affine(offset=(3, 0, 0))))
    assert world_radius(find_instances(state)) == pytest.approx(np.sqrt(16 + 1 + 1), rel=0.3)
