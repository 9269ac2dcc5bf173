"""The padding of boxes: a box is met at the very t that the triangle test computes for a triangle in it.

t_min and t_max are both that t, and the box is the triangle's own, so that nothing but the padding makes room.
"""

import itertools

import numpy as np
import pytest

from clbvh.structs import HIT, LAYOUT_WIDTHS, NO_PRIM, TRIANGLE, WIDE_NODES

from ..profiles import seeds
from ..rays import aim, as_float32
from .test_beam import RAYS, UNBOUNDED
from .test_slabs import LAYOUT_NAMES

COUNT = 60_000


def grazed_triangles(count, generator):
    """Corners, (n, 3, 3), and a point of each: any, flat or thin along an axis, in a slanted plane, long and narrow."""
    corners = generator.uniform(-1, 1, (count, 3, 3)) * 10.0 ** generator.uniform(-6, 0, (count, 1, 3))
    kind = generator.integers(0, 5, count)
    corners[kind == 1, :, 2] = corners[kind == 1, :1, 2]
    corners[kind == 2, :, 2] = corners[kind == 2, :, :2].sum(axis=2)
    corners[kind == 3, :, 2] *= 10.0 ** generator.uniform(-20, -6, ((kind == 3).sum(), 1))
    long = kind == 4
    corners[long, 2] = corners[long, 0] + generator.uniform(0, 1, (long.sum(), 1)) * (
        corners[long, 1] - corners[long, 0]
    )
    corners[long, 2] += 10.0 ** generator.uniform(-9, -3, (long.sum(), 1)) * generator.normal(size=(long.sum(), 3))
    permutation = np.argsort(generator.random((count, 3)), axis=1)[:, None]
    corners = as_float32(np.take_along_axis(corners, permutation, axis=2))
    return corners, np.einsum("ni,nij->nj", generator.dirichlet([1, 1, 1], count), corners)


def grazing_rays(corners, targets, generator):
    """From close above the plane of each triangle, at any distance, to a point of it or from there."""
    count = len(corners)
    along = np.einsum("ni,nij->nj", generator.normal(size=(count, 2)), corners[:, 1:] - corners[:, :1])
    along *= 10.0 ** generator.uniform(-8, 1, (count, 1))
    height = np.abs(along).max(axis=1, keepdims=True) * 10.0 ** generator.uniform(-9, 0, (count, 1))
    origins, directions = aim(targets + along + height * generator.normal(size=(count, 3)), targets)
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    # Some are parallel to the side along which the triangle is thinnest.
    parallel = np.flatnonzero(generator.random(count) < 0.2)
    thinnest = np.ptp(corners[parallel], axis=1).argmin(axis=1)
    origins[parallel, thinnest], directions[parallel, thinnest] = as_float32(targets[parallel, thinnest]), 0
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    exponent = np.frexp(np.abs(directions).max(axis=1, keepdims=True))[1]
    return origins, as_float32(np.ldexp(directions, -exponent))


@pytest.fixture(scope="module", params=seeds(2))
def hits(request, run_shell, make_rays):
    """Rays with t_min and t_max at the t of the triangle that they hit, and the boxes of these triangles."""
    generator = np.random.default_rng([41, request.param])
    corners, targets = grazed_triangles(COUNT, generator)
    origins, directions = grazing_rays(corners, targets, generator)
    triangles, before = np.zeros(COUNT, TRIANGLE), np.zeros(COUNT, HIT)
    for index, name in enumerate("abc"):
        triangles[name] = corners[:, index]
    before["t"], before["prim_id"] = np.inf, NO_PRIM
    rays = make_rays(origins, directions)
    found, _ = run_shell("cross_triangles", [rays, triangles, before], [HIT, np.int32])
    is_hit = found["prim_id"] != NO_PRIM
    assert is_hit.mean() > 0.3
    rays["t_min"] = rays["t_max"] = found["t"]
    boxes = np.stack((corners.min(axis=1), corners.max(axis=1)), axis=1).astype(np.float32)
    return rays[is_hit], boxes[is_hit]


def test_the_box_of_a_hit_is_met(run_shell, hits):
    rays, boxes = hits
    is_met, t_nears = run_shell("meet_boxes", [rays, boxes.reshape(-1, 6)], [np.int32, np.float32])
    np.testing.assert_array_equal(np.flatnonzero(is_met == 0), [])
    assert (t_nears <= rays["t_max"]).all()


def make_nodes(boxes, width):
    """Nodes with one child each."""
    greatest = np.finfo(np.float32).max
    nodes = np.zeros(len(boxes), WIDE_NODES[width])
    nodes["aabb_min"], nodes["aabb_max"] = greatest, -greatest
    nodes["aabb_min"][:, :, 0], nodes["aabb_max"][:, :, 0] = boxes[:, 0], boxes[:, 1]
    return nodes


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_the_box_of_a_hit_is_met_in_lanes(run_lane_shell, hits, layout, portable):
    rays, boxes = hits
    nodes = make_nodes(boxes, LAYOUT_WIDTHS[layout])
    (met,) = run_lane_shell(layout, "meet_children", [rays, nodes], [np.uint32], portable=portable)
    np.testing.assert_array_equal(np.flatnonzero(met != 1), [])


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_the_box_of_a_hit_is_met_by_a_beam_of_that_ray(run_lane_shell, hits, layout):
    rays, boxes = hits
    nodes = make_nodes(boxes, LAYOUT_WIDTHS[layout])
    (met,) = run_lane_shell(layout, "meet_by_beam", [nodes, np.repeat(rays, RAYS)], [np.uint32])
    np.testing.assert_array_equal(np.flatnonzero((met != 1) & (met != UNBOUNDED)), [])
    assert (met == 1).mean() > 0.9


# Distances in multiples of the unit roundoff. A box beside a ray along z has 14 of padding, and little more. A box that
# a diagonal ray enters along x behind where it leaves it along z has twice 14 + 28; four times that from an origin at
# distance 3. The test rounds by 2 or 3 itself, and by four times that.
BESIDE = {11.5: True, 16.5: False}
BEHIND = {80.0: True, 88.0: False}
BEHIND_FROM_AFAR = {320.0: True, 352.0: False}
UNIT_ROUNDOFF = 2.0**-24
AFAR = 3.0


def list_gaps():
    """An origin, a direction, a box, and whether they meet."""
    for gap, is_met in BESIDE.items():
        yield [0, 0, -2], [0, 0, 1], [[gap * UNIT_ROUNDOFF, -1, -1], [1, 1, 1]], is_met
    for distance, gaps in ((0.0, BEHIND), (AFAR, BEHIND_FROM_AFAR)):
        for gap, is_met in gaps.items():
            yield [-distance, 0, -distance], [1, 0, 1], [[0.5 + gap * UNIT_ROUNDOFF, -1, -1], [1, 1, 0.5]], is_met


# The same behind a box of a ray from far away: 2 * 28 times its reach along the axis that it follows, which is 8, and
# 14 times 8 and 2 * 3.5 for the distances.
BEHIND_FROM_FAR = {600.0: True, 720.0: False}


@pytest.fixture(scope="module")
def gaps(make_rays):
    """Rays and boxes in all permutations of the axes, forwards and backwards, and whether they meet."""
    rays, boxes, expected = [], [], []
    for turn in range(3):
        for sign in (1, -1):
            for origin, direction, box, is_met in list_gaps():
                rays.append(make_rays(np.roll(origin, turn) * sign, np.roll(direction, turn) * sign))
                boxes.append(np.sort(np.roll(box, turn, axis=1) * sign, axis=0).astype(np.float32))
                expected.append(is_met)
            for across, (gap, is_met) in itertools.product((1, 2), BEHIND_FROM_FAR.items()):
                # The ray leaves the box at 6.5 along one axis, and enters it there along another, at half the speed.
                box = np.array([[-1, -1, -1], [-0.5, 1, 1]])
                origin, direction = np.array([-7.0, 0, 0]), np.array([1.0, 0, 0])
                origin[across], direction[across] = -2.5, 0.5
                box[0, across] = 0.75 + gap / 2 * UNIT_ROUNDOFF
                rays.append(make_rays(np.roll(origin, turn) * sign, np.roll(direction, turn) * sign))
                boxes.append(np.sort(np.roll(box, turn, axis=1) * sign, axis=0).astype(np.float32))
                expected.append(is_met)
    return np.concatenate(rays), np.array(boxes), np.array(expected)


def test_the_padding_is_as_wide_as_derived(run_shell, gaps):
    rays, boxes, expected = gaps
    is_met, _ = run_shell("meet_boxes", [rays, boxes.reshape(-1, 6)], [np.int32, np.float32])
    np.testing.assert_array_equal(is_met == 1, expected)


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_the_padding_in_lanes_is_as_wide_as_derived(run_lane_shell, gaps, layout):
    rays, boxes, expected = gaps
    nodes = make_nodes(boxes, LAYOUT_WIDTHS[layout])
    (met,) = run_lane_shell(layout, "meet_children", [rays, nodes], [np.uint32])
    np.testing.assert_array_equal(met == 1, expected)
    (met,) = run_lane_shell(layout, "meet_by_beam", [nodes, np.repeat(rays, RAYS)], [np.uint32])
    np.testing.assert_array_equal(met == 1, expected)
