"""The padding of boxes: a box is met at the very t that is computed for a triangle or a sphere in it.

t_min and t_max are both that t, and the box is that of the triangle or sphere itself, so that nothing but the padding
makes room; see docs/internals/padding.md.
"""

import numpy as np
import pytest

from clbvh.geometry.spheres import bound_spheres
from clbvh.structs import HIT, NO_PRIM

from ..profiles import seeds
from ..rays import aim, as_float32
from ..spheres import spheres_as_on_device
from .boxes import BEAM_RAYS, BEAMS, UNBOUNDED, WAYS, meet, meet_alone, meet_by_beam
from .programs import make_rays, make_triangles
from .test_spheres import cross_spheres, make_records
from .test_triangles import cross_triangles

pytestmark = pytest.mark.on_both

COUNT = 60_000
UNIT_ROUNDOFF = 2.0**-24


def scaled(directions):
    """Directions with a largest component of about 1."""
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    exponent = np.frexp(np.abs(directions).max(axis=1, keepdims=True))[1]
    return as_float32(np.ldexp(directions, -exponent))


def grazed_triangles(generator):
    """Corners, (n, 3, 3), and a point of each: any, flat or thin along an axis, in a slanted plane, long and narrow."""
    corners = generator.uniform(-1, 1, (COUNT, 3, 3)) * 10.0 ** generator.uniform(-6, 0, (COUNT, 1, 3))
    kind = generator.integers(0, 5, COUNT)
    corners[kind == 1, :, 2] = corners[kind == 1, :1, 2]
    corners[kind == 2, :, 2] = corners[kind == 2, :, :2].sum(axis=2)
    corners[kind == 3, :, 2] *= 10.0 ** generator.uniform(-20, -6, ((kind == 3).sum(), 1))
    a, b, _ = corners[kind == 4].transpose(1, 0, 2)
    beside = 10.0 ** generator.uniform(-9, -3, (len(a), 1)) * generator.normal(size=a.shape)
    corners[kind == 4, 2] = a + generator.uniform(0, 1, (len(a), 1)) * (b - a) + beside
    permutation = np.argsort(generator.random((COUNT, 3)), axis=1)[:, None]
    corners = as_float32(np.take_along_axis(corners, permutation, axis=2))
    return corners, np.einsum("ni,nij->nj", generator.dirichlet([1, 1, 1], COUNT), corners)


def hit_triangles(call, generator):
    """Rays from close above the planes of triangles, the t at which they hit these, and the boxes."""
    corners, targets = grazed_triangles(generator)
    along = np.einsum("ni,nij->nj", generator.normal(size=(COUNT, 2)), corners[:, 1:] - corners[:, :1])
    along *= 10.0 ** generator.uniform(-8, 1, (COUNT, 1))
    height = np.abs(along).max(axis=1, keepdims=True) * 10.0 ** generator.uniform(-9, 0, (COUNT, 1))
    origins, directions = aim(targets + along + height * generator.normal(size=(COUNT, 3)), targets)
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    # Some are parallel to the side along which the triangle is thinnest.
    parallel = np.flatnonzero(generator.random(COUNT) < 0.2)
    thinnest = np.ptp(corners[parallel], axis=1).argmin(axis=1)
    origins[parallel, thinnest], directions[parallel, thinnest] = as_float32(targets[parallel, thinnest]), 0
    rays = make_rays(origins, scaled(directions))
    hits = cross_triangles(call, rays, make_triangles(corners))
    return rays, hits, np.stack((corners.min(axis=1), corners.max(axis=1)), axis=1).astype(np.float32)


def hit_spheres(call, generator):
    """Rays to where spheres are farthest along an axis, and just beside it; their crossings, and the boxes."""
    radii = 10.0 ** generator.uniform(-7, -0.1, COUNT)
    spheres = spheres_as_on_device(generator.uniform(-1, 1, (COUNT, 3)) * (1 - radii[:, None]) * 0.999, radii)
    pole = np.zeros((COUNT, 3))
    pole[np.arange(COUNT), generator.integers(0, 3, COUNT)] = generator.choice([-1, 1], COUNT)
    beside = 1 + generator.choice([-1, 0, 1], (COUNT, 1)) * 2.0**-22
    targets = spheres.centres + spheres.radii[:, None] * pole * beside
    origins = targets + generator.normal(size=(COUNT, 3)) * 10.0 ** generator.uniform(-6, 3, (COUNT, 1))
    # Most rays touch the surface there: they run at right angles to the way from the centre.
    flat = generator.random(COUNT) < 0.7
    origins[flat] = np.where(pole == 0, origins, targets)[flat]
    origins, directions = aim(origins, targets)
    rays = make_rays(origins, scaled(directions))
    hits, _ = cross_spheres(call, rays, make_records(spheres.centres, spheres.radii))
    boxes = bound_spheres(spheres)
    which = np.repeat(np.arange(COUNT), 2)
    return rays[which], hits.reshape(-1), boxes[which]


@pytest.fixture(scope="module", params=seeds(2))
def crossings(request, call):
    """Rays with t_min and t_max at the t of a crossing, and the boxes of what they cross; by its kind."""
    found = {}
    for kind, cross in {"triangles": hit_triangles, "spheres": hit_spheres}.items():
        rays, hits, boxes = cross(call, np.random.default_rng([41, request.param]))
        assert hits.dtype == HIT
        is_hit = hits["prim_id"] != NO_PRIM
        assert is_hit.mean() > 0.3
        rays["t_min"] = rays["t_max"] = hits["t"]
        found[kind] = rays[is_hit], boxes[is_hit]
    return found


@pytest.mark.parametrize("way", WAYS)
def test_the_box_of_a_crossing_is_met(call, crossings, way):
    for kind, (rays, boxes) in crossings.items():
        np.testing.assert_array_equal(np.flatnonzero(~meet(call, way, rays, boxes)), [], kind)
        if way == "single":
            assert (meet_alone(call, rays, boxes)[1] <= rays["t_max"]).all()
        if way in BEAMS:
            met = meet_by_beam(call, way.split()[0], np.repeat(rays, BEAM_RAYS).reshape(-1, BEAM_RAYS), boxes)
            assert (met == UNBOUNDED).mean() < {"triangles": 0.1, "spheres": 0.5}[kind]


def test_crossings_of_spheres_lie_within_the_derived_bound(crossings):
    """The bound itself, in float64: 2 R + 21 s R of the longest axis besides the margin, along each axis."""
    rays, boxes = crossings["spheres"]
    origins, directions = rays["origin"].astype(np.float64), rays["direction"].astype(np.float64)
    points = origins + rays["t_min"].astype(np.float64)[:, None] * directions
    longest = np.abs(directions).argmax(axis=1)[:, None]
    slope = np.abs(directions / np.take_along_axis(directions, longest, axis=1))
    reach = np.abs(origins) + 1
    bound = UNIT_ROUNDOFF * (2 * reach + 21 * slope * np.take_along_axis(reach, longest, axis=1))
    assert (points >= boxes[:, 0] - bound).all()
    assert (points <= boxes[:, 1] + bound).all()


# Distances in multiples of the unit roundoff. A box beside a ray along z has 14 of padding, and little more. A box that
# a diagonal ray enters along x behind where it leaves it along z has twice 14 + 28; four times that from an origin at
# distance 3. The test rounds by 2 or 3 itself, and by four times that.
BESIDE = {11.5: True, 16.5: False}
BEHIND = {80.0: True, 88.0: False}
BEHIND_FROM_AFAR = {320.0: True, 352.0: False}
AFAR = 3.0

# The same behind a box of a ray from far away: 2 * 28 times its reach along the axis that it follows, which is 8, and
# 14 times 8 and 2 * 3.5 for the distances.
BEHIND_FROM_FAR = {600.0: True, 720.0: False}


def list_gaps():
    """An origin, a direction, a box, and whether they meet."""
    for gap, is_met in BESIDE.items():
        yield [0, 0, -2], [0, 0, 1], [[gap * UNIT_ROUNDOFF, -1, -1], [1, 1, 1]], is_met
    for distance, gaps in ((0.0, BEHIND), (AFAR, BEHIND_FROM_AFAR)):
        for gap, is_met in gaps.items():
            yield [-distance, 0, -distance], [1, 0, 1], [[0.5 + gap * UNIT_ROUNDOFF, -1, -1], [1, 1, 0.5]], is_met
    # The ray leaves the box at 6.5 along one axis, and enters it there along another, at half the speed.
    for gap, is_met in BEHIND_FROM_FAR.items():
        enters = 0.75 + gap / 2 * UNIT_ROUNDOFF
        yield [-7, -2.5, 0], [1, 0.5, 0], [[-1, enters, -1], [-0.5, 1, 1]], is_met
        yield [-7, 0, -2.5], [1, 0, 0.5], [[-1, -1, enters], [-0.5, 1, 1]], is_met


@pytest.mark.parametrize("way", WAYS)
def test_the_padding_is_as_wide_as_derived(call, way):
    origins, directions, boxes, expected = (np.array(column) for column in zip(*list_gaps(), strict=True))
    for turn in range(3):
        for sign in (1, -1):
            rays = make_rays(*(np.roll(part, turn, axis=1) * sign for part in (origins, directions)))
            turned = np.sort(np.roll(boxes, turn, axis=2) * sign, axis=1).astype(np.float32)
            np.testing.assert_array_equal(meet(call, way, rays, turned), expected)
