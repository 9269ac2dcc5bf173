"""The oracle: right answers by formula pass, and each kind of wrong answer is found."""

from dataclasses import replace

import numpy as np
import pytest

from clbvh.geometry.shapes.make_shape import make_shape
from clbvh.structs import NO_PRIM
from clbvh.trace.hits.hits import Hits

from ...mesh_reference import Difference, find_differences
from ...rays import aim, as_float32, mesh_as_on_device

# A right triangle at z = 0 and the same one at z = -1, then one that is a line.
VERTICES = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1], [1, 0, -1], [0, 1, -1], [2, 0, 0], [3, 0, 0], [4, 0, 0]]
FACES = [[0, 1, 2], [3, 4, 5], [6, 7, 8]]


@pytest.fixture
def mesh():
    return mesh_as_on_device(VERTICES, FACES)


def make_hits(*rows):
    t, u, v, prim_id = zip(*rows, strict=True)
    return Hits(*(np.array(field, np.float32) for field in (t, u, v)), np.array(prim_id, np.int32))


MISS = (np.inf, 0, 0, NO_PRIM)
DOWN = ([[0.25, 0.5, 2]], [[0, 0, -1]])


def differences_of(mesh, rays, *hits):
    return find_differences(mesh, np.array(rays[0], float), np.array(rays[1], float), make_hits(*hits))


class TestOneTriangle:
    def test_the_formula_is_right(self, mesh):
        assert differences_of(mesh, DOWN, (2, 0.25, 0.5, 0)) == []

    def test_from_below_it_is_the_other_one(self, mesh):
        up = ([[0.25, 0.5, -3]], [[0, 0, 1]])
        assert differences_of(mesh, up, (2, 0.25, 0.5, 1)) == []
        (found,) = differences_of(mesh, up, (3, 0.25, 0.5, 0))
        assert found == Difference(0, 3.0, 0, 2.0, 1)

    @pytest.mark.parametrize("length", [1e-12, 0.1, 3, 1e12])
    def test_t_counts_in_lengths_of_the_direction(self, mesh, length):
        rays = (DOWN[0], [[0, 0, -length]])
        assert differences_of(mesh, rays, (2 / length, 0.25, 0.5, 0)) == []
        assert len(differences_of(mesh, rays, (2.0001 / length, 0.25, 0.5, 0))) == 1

    def test_a_miss_is_a_miss(self, mesh):
        beside = ([[0.75, 0.5, 2], [0.25, 0.5, -2], [0.25, 0.5, 2]], [[0, 0, -1], [0, 0, -1], [0, 0, 1]])
        assert differences_of(mesh, beside, MISS, MISS, MISS) == []

    @pytest.mark.parametrize("point", [(0, 0), (1, 0), (0, 1), (0.5, 0), (0, 0.5), (0.5, 0.5)])
    def test_on_an_edge_both_answers_are_right(self, mesh, point):
        ray = ([[*point, 2]], [[0, 0, -1]])
        assert differences_of(mesh, ray, (2, *point, 0)) == []
        # Past the first triangle, it can still hit the second, or neither.
        assert differences_of(mesh, ray, (3, *point, 1)) == []
        assert differences_of(mesh, ray, MISS) == []

    @pytest.mark.parametrize(
        ("point", "u", "v"), [((0, 0.5), -1e-7, 0.5), ((0.5, 0), 0.5, -1e-7), ((0.5, 0.5), 0.5, 0.500002)]
    )
    def test_u_and_v_never_leave_the_triangle(self, mesh, point, u, v):
        assert len(differences_of(mesh, ([[*point, 2]], [[0, 0, -1]]), (2, u, v, 0))) == 1

    def test_just_inside_the_edge_a_miss_is_wrong(self, mesh):
        assert len(differences_of(mesh, ([[0.5, 1e-5, 2]], [[0, 0, -1]]), MISS)) == 1
        assert len(differences_of(mesh, ([[0.5, -1e-5, 2]], [[0, 0, -1]]), (2, 0.5, 0, 0))) == 1

    def test_an_origin_on_the_triangle_may_count_or_not(self, mesh):
        ray = ([[0.25, 0.5, 0]], [[0, 0, -1]])
        assert differences_of(mesh, ray, (0, 0.25, 0.5, 0)) == []
        assert differences_of(mesh, ray, (1, 0.25, 0.5, 1)) == []

    def test_a_ray_in_the_plane_is_too_close_to_call(self, mesh):
        ray = ([[-1, 0.25, 0]], [[1, 0, 0]])
        assert differences_of(mesh, ray, MISS) == []
        assert differences_of(mesh, ray, (1.5, 0.5, 0.25, 0)) == []
        # But not beside the triangle.
        assert len(differences_of(mesh, ([[-1, 1.5, 0]], [[1, 0, 0]]), (1, 0, 1, 0))) == 1


WRONG = {
    "missed": MISS,
    "the-one-behind": (3, 0.25, 0.5, 1),
    "another-triangle": (2, 0.25, 0.5, 1),
    "degenerate": (2, 0.25, 0.5, 2),
    "no-such-face": (2, 0.25, 0.5, 3),
    "far-from-any-face": (2, 0.25, 0.5, 2**31 - 1),
    "negative-face": (2, 0.25, 0.5, -2),
    "t-too-small": (1.9999, 0.25, 0.5, 0),
    "t-too-large": (2.0001, 0.25, 0.5, 0),
    "t-negative": (-2, 0.25, 0.5, 0),
    "t-nan": (np.nan, 0.25, 0.5, 0),
    "t-infinite": (np.inf, 0.25, 0.5, 0),
    "u-and-v-swapped": (2, 0.5, 0.25, 0),
    "u-off": (2, 0.2501, 0.5, 0),
    "v-off": (2, 0.25, 0.4999, 0),
    "u-nan": (2, np.nan, 0.5, 0),
    "v-nan": (2, 0.25, np.nan, 0),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_each_kind_of_wrong_answer_is_found(mesh, wrong):
    rays = [np.repeat(array, 3, axis=0) for array in DOWN]
    right = (2, 0.25, 0.5, 0)
    (found,) = differences_of(mesh, rays, right, wrong, right)
    assert (found.ray, found.obtained_prim_id, found.expected_t, found.expected_prim_id) == (1, wrong[3], 2, 0)
    np.testing.assert_equal(found.obtained_t, float(np.float32(wrong[0])))


@pytest.mark.parametrize("hit", [(2, 0, 1, 0), (1, 0.5, 0.5, 1), (np.nan, 0, 0, 0), (5, 0, 0, NO_PRIM)])
def test_a_hit_where_nothing_is_is_found(mesh, hit):
    (found,) = differences_of(mesh, ([[5, 5, 2]], [[0, 0, -1]]), hit)
    assert (found.expected_t, found.expected_prim_id) == (np.inf, NO_PRIM)


def test_a_degenerate_triangle_is_never_hit(mesh):
    # The ray meets the line that the third triangle is.
    ray = ([[3, 0, 2]], [[0, 0, -1]])
    assert len(differences_of(mesh, ray, (2, 1, 0, 2))) == 1
    assert differences_of(mesh, ray, MISS) == []


def test_a_difference_is_one_sentence():
    text = str(Difference(12, 2.5, 3, 2.0, 1))
    assert text == "ray 12: obtained t = 2.5 on triangle 3, expected t = 2 on triangle 1"


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e8])
@pytest.mark.parametrize("seed", range(2))
class TestASphere:
    """From the centre of a fine icosphere every ray hits at t near 1, on the face that it was aimed at."""

    @pytest.fixture
    def answer(self, scale, seed):
        unit = make_shape("icosphere", triangles=320)
        mesh = mesh_as_on_device(unit.vertices * scale, unit.faces)
        generator = np.random.default_rng([40, seed])
        prims = generator.permutation(mesh.face_count)
        weights = generator.dirichlet([2, 2, 2], len(prims))
        weights = (weights + 0.02) / 1.06
        corners = mesh.vertices[mesh.faces[prims]]
        points = np.einsum("ni,nij->nj", weights, corners)
        origins, directions = aim(np.zeros_like(points), points)
        hits = Hits(np.ones(len(prims), np.float32), *weights.T[1:].astype(np.float32), prims.astype(np.int32))
        return mesh, origins, directions, hits

    def test_the_right_answer_passes(self, answer):
        assert find_differences(*answer) == []

    def test_a_neighbour_does_not(self, answer):
        mesh, origins, directions, hits = answer
        shifted = replace(hits, prim_id=np.roll(hits.prim_id, 1))
        assert len(find_differences(mesh, origins, directions, shifted)) == mesh.face_count

    def test_a_small_error_in_t_does_not(self, answer):
        mesh, origins, directions, hits = answer
        for factor in (1 - 1e-5, 1 + 1e-5):
            shifted = replace(hits, t=hits.t * np.float32(factor))
            assert len(find_differences(mesh, origins, directions, shifted)) == mesh.face_count

    def test_a_small_error_in_u_does_not(self, answer):
        mesh, origins, directions, hits = answer
        shifted = replace(hits, u=hits.u + np.float32(1e-3))
        assert len(find_differences(mesh, origins, directions, shifted)) == mesh.face_count

    def test_a_wrong_side_does_not(self, answer):
        mesh, origins, directions, hits = answer
        assert len(find_differences(mesh, origins, -directions, hits)) == mesh.face_count

    def test_missing_one_is_found(self, answer):
        mesh, origins, directions, hits = answer
        t, prim_id = hits.t.copy(), hits.prim_id.copy()
        t[7], prim_id[7] = np.inf, NO_PRIM
        (found,) = find_differences(mesh, origins, directions, replace(hits, t=t, prim_id=prim_id))
        assert found.ray == 7
        assert found.expected_prim_id == hits.prim_id[7]


def test_tilted_triangles_are_judged_in_their_own_plane():
    generator = np.random.default_rng(41)
    corners = as_float32(generator.uniform(-1, 1, (200, 3, 3)))
    weights = generator.dirichlet([3, 3, 3], 200)
    points = np.einsum("ni,nij->nj", weights, corners)
    origins, directions = aim(generator.uniform(-4, 4, points.shape), points)
    judged = 0
    for prim in range(200):
        mesh = mesh_as_on_device(corners[prim], [[0, 1, 2]])
        ray = slice(prim, prim + 1)
        normal = np.cross(corners[prim, 1] - corners[prim, 0], corners[prim, 2] - corners[prim, 0])
        if abs(normal @ directions[prim]) < 0.5 * np.linalg.norm(directions[prim]):
            continue
        judged += 1
        # Solved as a linear system: origin + t direction = a + u (b - a) + v (c - a).
        a, b, c = corners[prim]
        t, u, v = np.linalg.solve(np.stack((-directions[prim], b - a, c - a), axis=1), origins[prim] - a)
        hit = make_hits((t, u, v, 0))
        assert find_differences(mesh, origins[ray], directions[ray], hit) == []
        assert len(find_differences(mesh, origins[ray], directions[ray], replace(hit, t=hit.t * 1.00002))) == 1
        assert len(find_differences(mesh, origins[ray], directions[ray], replace(hit, v=hit.v + 0.0005))) == 1
    assert judged > 80
