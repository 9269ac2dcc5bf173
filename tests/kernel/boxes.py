"""Which rays meet which boxes: by the device in every way that it asks, and by float64."""

import numpy as np

from clbvh.tree_layouts import LAYOUTS, WIDE_LAYOUTS, wide_node

LANES = [*WIDE_LAYOUTS, *(f"{layout} portable" for layout in WIDE_LAYOUTS)]
BEAMS = [f"{layout} beam" for layout in WIDE_LAYOUTS]
WAYS = ["single", *LANES, *BEAMS]

# Rays of a beam, and the answer of a beam without bounds.
BEAM_RAYS = 8
UNBOUNDED = 1 << 20

# Coordinates of a mesh are at most 1. The device meets no box that misses the ray by more than this share of 1 and the
# origin's largest coordinate: 14 roundings and 28 of padding, 8 of the test itself, and little more for the slopes that
# count as zero.
LARGEST = 1.0
PADDING = 51 * 2.0**-24

ALONE = """
    const ray_t unpacked = unpack_ray(ray);
    const padded_ray_t padded = pad_ray(&unpacked);
    is_met = meets_aabb(lower, upper, &padded, unpacked.t_max, &t_near);
"""

IN_LANES = """
    const ray_t unpacked = unpack_ray(ray);
    const slabs_t slabs = make_slabs(&unpacked);
    lanes_t t_near;
    met = meets_children(node, &slabs, unpacked.t_max * slabs.unit, &t_near);
"""

BY_BEAM = f"""
    ray_bounds_t bounds = empty_bounds();
    for (int ray = 0; ray < {BEAM_RAYS}; ray++) {{
        include_ray(&bounds, ((const global float8 *)rays)[ray]);
    }}
    const beam_t beam = make_beam(&bounds);
    met = beam.is_empty ? 0 : beam.is_unbounded ? {UNBOUNDED} : beam_meets_children(node, &beam);
"""


def meet_alone(call, rays, boxes):
    """Which rays meet their boxes, (n, 2, 3), and the t at which they enter."""
    lower, upper = boxes.transpose(1, 0, 2)
    outputs = "int is_met, float t_near"
    is_met, t_nears = call("boxes/aabb.cl", ALONE, outputs, ray=rays, lower=lower, upper=upper)
    return is_met == 1, t_nears


def meet_by_beam(call, layout, beams, boxes):
    """Whether beams of rays, (n, BEAM_RAYS), meet their boxes: 0, 1 or UNBOUNDED."""
    includes = "traversal/traverse.cl boxes/beam.cl"
    nodes, bits = _make_nodes(layout, boxes)
    met = call(includes, BY_BEAM, "uint met", rays=beams, node=nodes, layout=layout)
    assert (met & ~(bits | UNBOUNDED) == 0).all()
    return np.minimum(met, 1) + (met == UNBOUNDED) * np.uint32(UNBOUNDED - 1)


def meet(call, way, rays, boxes):
    """Which rays meet their boxes, in one of the `WAYS`; nodes have one child, and no other is met."""
    layout, *how = way.split()
    if layout == "single":
        return meet_alone(call, rays, boxes)[0]
    if how == ["beam"]:
        return meet_by_beam(call, layout, np.repeat(rays, BEAM_RAYS).reshape(-1, BEAM_RAYS), boxes) > 0
    nodes, bits = _make_nodes(layout, boxes)
    defines = {"PORTABLE": 1} if how else {}
    met = call("traversal/traverse.cl", IN_LANES, "uint met", ray=rays, node=nodes, layout=layout, defines=defines)
    assert (met & ~bits == 0).all()
    return met > 0


def _make_nodes(layout, boxes):
    """Nodes with one child each, in any lane, and the bits of these lanes."""
    width, rows = LAYOUTS[layout].width, np.arange(len(boxes))
    nodes = np.zeros(len(boxes), wide_node(width))
    nodes["aabb_min"], nodes["aabb_max"] = np.finfo(np.float32).max, -np.finfo(np.float32).max
    nodes["aabb_min"][rows, :, rows % width], nodes["aabb_max"][rows, :, rows % width] = boxes.transpose(1, 0, 2)
    return nodes, np.uint32(1) << np.uint32(rows % width)


def pad(rays, boxes):
    """The boxes, with the padding that docs/internals/padding.md derives, but for what the slab test may round."""
    size, reach = np.abs(rays["direction"].astype(np.float64)), np.abs(rays["origin"].astype(np.float64)) + LARGEST
    longest = size.argmax(axis=-1)[..., None]
    slope = size / np.take_along_axis(size, longest, axis=-1)
    padding = 2.0**-24 * ((13 - 8) * reach + 27 * slope * np.take_along_axis(reach, longest, axis=-1))
    return boxes + np.stack((-padding, padding), axis=1)


def grow(rays, boxes):
    """The boxes, padded by what the device adds at most."""
    padding = PADDING * (np.abs(rays["origin"].astype(np.float64)).max(axis=-1) + LARGEST)
    return boxes + padding[:, None, None] * np.array([[-1], [1]])


def clip(rays, boxes):
    """Where each ray enters and leaves its box in float64; inside a slab is closed."""
    origins, directions = rays["origin"].astype(np.float64), rays["direction"].astype(np.float64)
    lower, upper = boxes.astype(np.float64).transpose(1, 0, 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_lower, to_upper = (lower - origins) / directions, (upper - origins) / directions
    is_inside = (lower <= origins) & (origins <= upper)
    is_parallel = directions == 0
    near = np.where(is_parallel, np.where(is_inside, -np.inf, np.inf), np.minimum(to_lower, to_upper))
    far = np.where(is_parallel, np.where(is_inside, np.inf, -np.inf), np.maximum(to_lower, to_upper))
    return np.maximum(near.max(axis=1), rays["t_min"]), np.minimum(far.min(axis=1), rays["t_max"])
