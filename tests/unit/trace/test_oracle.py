"""The oracle: right answers by formula pass, each wrong one is found, doubt is admitted."""

from types import SimpleNamespace

import numpy as np

from clbvh import Mesh, Spheres
from clbvh.trace.check.intersections import Rays
from clbvh.trace.check.reference import Reference

from ...all_hits_reference import find_wrong_crossings
from .scene_states import affine, make_state

NAN, INF = np.nan, np.inf
NOT_HERE = "the ray does not cross this primitive at this t"
TWIN = "an equal primitive in the same place has smaller ids"


def hit(t, instance, geometry, prim, u, v):
    fields = {"t": t, "instance_id": instance, "geometry_id": geometry, "prim_id": prim, "u": u, "v": v}
    return SimpleNamespace(**{name: np.atleast_1d(value) for name, value in fields.items()})


MISS = hit(INF, -1, -1, -1, 0.0, 0.0)
DOWN = [[0.5, 0.25, 2]], [[0, 0, -1]]  # in the face 0 of the square, with u = 0.125 and v = 0.625
HERE = (0.125, 0.625)


def make_square():
    return Mesh.from_arrays([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def reasons(state, ray, hits, **limits):
    return [found.reason for found in Reference(state).find_differences(Rays.make(*ray, **limits), hits)]


def test_hits_in_a_scene_are_judged():
    state, away = make_state([make_square()], (0, affine()), (0, affine(offset=(0, 0, -1)))), (DOWN[0], [[0, 0, 1]])
    assert reasons(state, DOWN, hit(2.0, 0, 0, 0, *HERE)) == reasons(state, away, MISS) == []
    for wrong, reason in (
        (MISS, "a primitive is surely hit"),
        (hit(3.0, 1, 0, 0, *HERE), "another primitive is surely hit before it"),
        (hit(2.0, 0, 0, 1, *HERE), NOT_HERE),
        (hit(2.0001, 0, 0, 0, *HERE), NOT_HERE),
        (hit(NAN, 0, 0, 0, *HERE), NOT_HERE),
        (hit(2.0, 7, 0, 0, *HERE), NOT_HERE),
        *((hit(2.0, 0, 0, 0, u, 0.625), "u and v name a point") for u in (0.1251, NAN, -0.125)),
        (hit(2.0, 0, 1, 0, *HERE), "this is not the geometry of the instance"),
    ):
        (found,) = reasons(state, DOWN, wrong)
        assert found.startswith(reason), wrong
    for wrong in (hit(INF, 0, -1, -1, 0, 0), hit(INF, -1, 0, -1, 0, 0), hit(5.0, -1, -1, -1, 0, 0)):
        assert reasons(state, away, wrong) == ["a miss has no t and no ids"]
    for limits, expected, is_decided in (
        ({"t_min": 2.5}, 1, True), ({"t_max": 1.5}, -1, True), ({"t_min": 2.5, "t_max": 2.75}, -1, True),
        ({"t_max": 2.0}, -1, False), ({"t_min": 2.0}, 1, False),
    ):  # fmt: skip
        found = Reference(state).closest_hit(Rays.make(*DOWN, **limits))
        assert (found.instance_id[0], found.is_decided[0]) == (expected, is_decided), limits
    for beside, is_decided in ((1e-7, False), (-1e-7, False), (1e-3, True), (-1e-3, True)):
        ray = [[1 + beside, 0.25, 2]], [[0, 0, -1]]
        assert Reference(state).closest_hit(Rays.make(*ray)).is_decided[0] == is_decided, beside
        assert len(reasons(state, ray, MISS)) == (beside == -1e-3)
    assert reasons(make_state([make_square()]), DOWN, MISS) == []


def test_of_equal_primitives_in_one_place_the_first_wins():
    square, sheared = make_square(), affine(np.array([[1, 0.5, 0], [0, 1, 0.25], [0, 0, 1]]))
    ray, uv = ([[0.5, 0.125, 2]], [[0, 0, -1]]), (0.15625, 0.5625)
    state = make_state([square], (0, sheared, 1), (0, sheared, 1), (0, sheared, 2))
    for instance, mask, found in ((0, 3, []), (1, 3, [TWIN]), (2, 1, [NOT_HERE]), (2, 2, [])):
        assert reasons(state, ray, hit(2.0, instance, 0, 0, *uv), mask=mask) == found, (instance, mask)
    twice = Mesh.from_arrays(square.vertices, np.concatenate((square.faces, square.faces)))
    for prim, found in ((0, []), (2, [TWIN])):
        assert reasons(make_state([twice], (0, affine())), DOWN, hit(2.0, 0, 0, prim, *HERE)) == found
    touching = make_state([square], (0, affine()), (0, affine((1, 1, 2))))
    assert not Reference(touching).closest_hit(Rays.make(*DOWN)).is_decided
    for instance in (0, 1):
        assert reasons(touching, DOWN, hit(2.0, instance, 0, 0, *HERE)) == []


def test_hits_of_a_sphere_are_judged_by_their_angles_and_doubted_at_its_rim():
    reference = Reference(make_state([Spheres([[0, 0, 0]], 1.0)], (0, affine())))
    for beside, least, most in ((1 - 1e-7, 0, 2), (1 + 1e-7, 0, 2), (1 - 1e-4, 2, 2), (1 + 1e-4, 0, 0)):
        assert reference.count_range(Rays.make([[beside, 0, -3]], [[0, 0, 1]])) == (least, most), beside
    state = make_state([Spheres([[1, 0, 0], [9, 9, 9]], [0.5, 0.1])], (0, affine((1, 2, 1))))
    for wrong, *tuv in ((0, 2, 0.75, 0.5), (1, 2.001, 0.75, 0.5), (1, 2, 0.7501, 0.5), (1, 2, 0.75, 0.5001)):
        found = reasons(state, ([[1, -3, 0]], [[0, 1, 0]]), hit(tuv[0], 0, 0, 0, *tuv[1:]))
        assert len(found) == wrong, tuv


def test_all_hits_of_a_ray_are_judged():
    """Through three squares, two of which coincide."""
    reference = Reference(make_state([make_square()], *((0, affine(offset=(0, 0, z))) for z in (1, 0, 1))))

    def is_wrong(rows, ray=DOWN):
        t, instance, prim, u, v = np.array(rows, np.float64).reshape(-1, 5).T
        hits = hit(t, instance.astype(int), np.zeros(len(t), int), prim.astype(int), u, v)
        hits.offsets = np.array([0, len(t)])
        return find_wrong_crossings(reference, Rays.make(*ray), hits).tolist() == [0]

    first, second, third = right = (1, 0, 0, *HERE), (1, 2, 0, *HERE), (2, 1, 0, *HERE)
    assert not is_wrong(right)
    assert reference.count_range(Rays.make(*DOWN)) == (3, 3)
    for rows in (
        right[1:], (first, third), right[:2],  # one is missing
        (second, first, third), (first, third, second), (first, third, (2, *second[1:])),  # the order
        (*right, third), (*right, (2, 1, 1, *HERE)),  # one too many
        (first, second, (2, 1, 0, 0.125, 0.6)), (first, second, (2.0001, *third[1:])),
    ):  # fmt: skip
        assert is_wrong(rows), rows
    # At an edge, twins are both there or both not.
    right = [(*row[:3], 0.375, 0.625) for row in right]
    for rows, expected in ((right, False), (right[:2], False), ((), False), (right[::2], True)):
        assert is_wrong(rows, ([[1.0, 0.25, 2]], [[0, 0, -1]])) == expected, rows
