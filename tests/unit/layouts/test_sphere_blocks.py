"""The spheres of the leaves in every layout."""

from __future__ import annotations

import numpy as np
import pytest

from clbvh import BuildOptions, Mesh, Spheres, build, make_shape
from clbvh.builders.build import build_tree as build_any
from clbvh.layouts.device_arrays import make_device_arrays, measure_device_bytes
from clbvh.structs import BVH2_NODE, LAYOUT_WIDTHS, NO_PRIM, SPHERE, SPHERE_BLOCKS

WIDE = [layout for layout, width in LAYOUT_WIDTHS.items() if width > 2]


def make_spheres(count):
    rng = np.random.default_rng([count, 3])
    return Spheres(rng.normal(size=(count, 3)) + 100, rng.uniform(0.01, 0.1, count))


def build_tree(spheres, **options):
    return build_any(spheres, "sah", None, BuildOptions(**options))


@pytest.mark.parametrize("count", [1, 2, 500])
def test_single_spheres_are_in_the_order_of_the_leaves(count):
    spheres = make_spheres(count)
    bvh = build_tree(spheres)
    arrays = make_device_arrays(bvh, "bvh2")
    blocks = arrays.blocks
    assert (arrays.nodes.dtype, blocks.dtype, arrays.stack_size) == (BVH2_NODE, SPHERE, bvh.depth)
    assert blocks["prim_id"].tolist() == bvh.prim_ids.tolist()
    assert (blocks["centre"] == spheres.local_centres[bvh.prim_ids]).all()
    assert (blocks["radius"] == spheres.local_radii[bvh.prim_ids]).all()


@pytest.mark.parametrize("layout", WIDE)
@pytest.mark.parametrize("count", [1, 2, 13, 500])
def test_blocks_hold_every_sphere_once_and_nan_in_the_lanes_left_over(layout, count):
    spheres = make_spheres(count)
    blocks = make_device_arrays(build_tree(spheres), layout).blocks
    assert blocks.dtype == SPHERE_BLOCKS[LAYOUT_WIDTHS[layout]]
    empty = blocks["prim_id"] == NO_PRIM
    assert (np.isnan(blocks["radius"]) == empty).all()
    assert (np.isnan(blocks["centre"]) == empty[:, None]).all()
    prim_ids = blocks["prim_id"][~empty]
    assert sorted(prim_ids.tolist()) == list(range(count))
    assert (blocks["centre"].transpose(0, 2, 1)[~empty] == spheres.local_centres[prim_ids]).all()
    assert (blocks["radius"][~empty] == spheres.local_radii[prim_ids]).all()


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
@pytest.mark.parametrize("count", [1, 500])
def test_the_size_is_that_of_the_arrays(layout, count):
    spheres = make_spheres(count)
    bvh = build_tree(spheres)
    arrays = make_device_arrays(bvh, layout)
    assert measure_device_bytes(bvh, layout) == arrays.nodes.nbytes + arrays.blocks.nbytes


def make_icospheres(spheres):
    """Each sphere as 80 triangles."""
    ball = make_shape("icosphere", triangles=80)
    vertices = spheres.centres[:, None] + spheres.radii[:, None, None] * ball.vertices
    faces = ball.faces + len(ball.vertices) * np.arange(spheres.prim_count)[:, None, None]
    assert faces.shape[1] == 80
    return Mesh.from_arrays(vertices.reshape(-1, 3), faces.reshape(-1, 3))


@pytest.mark.parametrize("layout", LAYOUT_WIDTHS)
def test_spheres_take_a_fiftieth_of_icospheres_of_80_triangles(layout):
    spheres = make_spheres(500)
    icospheres = make_icospheres(spheres)
    of_spheres = measure_device_bytes(build_tree(spheres), layout)
    assert of_spheres < measure_device_bytes(build(icospheres), layout) / 50
