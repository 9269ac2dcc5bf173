"""The box of a sphere is met at the very t that the sphere test computes.

t_min and t_max are both that t, and the box is the sphere's own, so that nothing but the padding and the margin of the
box makes room; see docs/internals/padding.md.
"""

import numpy as np
import pytest

from clbvh.geometry.corners import bound_spheres
from clbvh.structs import HIT, LAYOUT_WIDTHS, LAYOUTS, NO_PRIM, SPHERE

from ..profiles import seeds
from ..rays import aim, as_float32
from ..spheres import spheres_as_on_device
from .test_beam import RAYS, UNBOUNDED
from .test_padding import make_nodes
from .test_slabs import LAYOUT_NAMES

COUNT = 60_000


def touching_rays(spheres, generator):
    """From anywhere, near, far or inside, to where the surface is farthest along an axis, and just beside it."""
    count = spheres.prim_count
    centres, radii = spheres.centres, spheres.radii[:, None]
    pole = np.zeros((count, 3))
    pole[np.arange(count), generator.integers(0, 3, count)] = generator.choice([-1, 1], count)
    targets = centres + radii * pole * (1 + generator.choice([-1, 0, 1], (count, 1)) * 2.0**-22)
    origins = targets + generator.normal(size=(count, 3)) * 10.0 ** generator.uniform(-6, 3, (count, 1))
    # Most rays touch the surface there: they run at right angles to the way from the centre.
    flat = generator.random(count) < 0.7
    origins[flat] = np.where(pole == 0, origins, targets)[flat]
    origins, directions = aim(origins, targets)
    directions[(directions == 0).all(axis=1)] = [0, 0, 1]
    exponent = np.frexp(np.abs(directions).max(axis=1, keepdims=True))[1]
    return origins, as_float32(np.ldexp(directions, -exponent))


@pytest.fixture(scope="module", params=seeds(2))
def hits(request, run_shell, make_rays):
    """Rays with t_min and t_max at the t of each crossing, and the boxes of the spheres."""
    generator = np.random.default_rng([96, request.param])
    radii = 10.0 ** generator.uniform(-7, -0.1, COUNT)
    centres = generator.uniform(-1, 1, (COUNT, 3)) * (1 - radii[:, None]) * 0.999
    spheres = spheres_as_on_device(centres, radii)
    rays = make_rays(*touching_rays(spheres, generator))
    given = np.zeros(COUNT, SPHERE)
    given["centre"], given["radius"] = spheres.local_centres, spheres.local_radii
    found, _, _ = run_shell(
        "cross_spheres", [rays, given], [(HIT, (2,)), HIT, np.int32], "sphere_shells",
        {"LAYOUT": LAYOUTS["brute"], "STACK_SIZE": 1, "HAS_SPHERES": 1},
    )  # fmt: skip
    boxes = bound_spheres(spheres)
    is_hit = found["prim_id"] != NO_PRIM
    assert is_hit.mean() > 0.3
    which, _ = np.nonzero(is_hit)
    of_hits = rays[which]
    of_hits["t_min"] = of_hits["t_max"] = found["t"][is_hit]
    return of_hits, boxes[which]


def test_the_box_of_a_crossing_is_met(run_shell, hits):
    rays, boxes = hits
    is_met, t_nears = run_shell("meet_boxes", [rays, boxes.reshape(-1, 6)], [np.int32, np.float32])
    np.testing.assert_array_equal(np.flatnonzero(is_met == 0), [])
    assert (t_nears <= rays["t_max"]).all()


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_the_box_of_a_crossing_is_met_in_lanes(run_lane_shell, hits, layout):
    rays, boxes = hits
    nodes = make_nodes(boxes, LAYOUT_WIDTHS[layout])
    (met,) = run_lane_shell(layout, "meet_children", [rays, nodes], [np.uint32])
    np.testing.assert_array_equal(np.flatnonzero(met != 1), [])


@pytest.mark.parametrize("layout", LAYOUT_NAMES)
def test_the_box_of_a_crossing_is_met_by_a_beam_of_that_ray(run_lane_shell, hits, layout):
    rays, boxes = hits
    nodes = make_nodes(boxes, LAYOUT_WIDTHS[layout])
    (met,) = run_lane_shell(layout, "meet_by_beam", [nodes, np.repeat(rays, RAYS)], [np.uint32])
    np.testing.assert_array_equal(np.flatnonzero((met != 1) & (met != UNBOUNDED)), [])
    assert (met == 1).mean() > 0.5


def test_crossings_lie_within_the_derived_bound_of_the_sphere(hits):
    """The bound itself, in float64: 2 R + 21 s R of the longest axis besides the margin, along each axis."""
    rays, boxes = hits
    origins, directions = rays["origin"].astype(np.float64), rays["direction"].astype(np.float64)
    points = origins + rays["t_min"].astype(np.float64)[:, None] * directions
    reach = np.abs(origins) + 1
    longest = np.abs(directions).argmax(axis=1)
    rows = np.arange(len(rays))
    slope = np.abs(directions / directions[rows, longest][:, None])
    bound = 2.0**-24 * (2 * reach + 21 * slope * reach[rows, longest][:, None])
    assert (points >= boxes[:, 0] - bound).all()
    assert (points <= boxes[:, 1] + bound).all()
