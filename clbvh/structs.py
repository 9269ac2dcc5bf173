"""Every struct that crosses to the device: its numpy dtype, its constants, and the C text made from both.

A struct is written down here once. Host arrays use the dtype, kernels include the text of `c_declarations`, and a
test writes a different value into every field and reads it back on each device.
"""

from __future__ import annotations

import numpy as np

# A node of the tree on the host: 32 bytes. `count > 0` is a leaf over prim_ids[first : first + count];
# `count == 0` is an interior node with its children at `first` and `first + 1`.
NODE = np.dtype(
    [
        ("aabb_min", np.float32, 3),
        ("first", np.int32),
        ("aabb_max", np.float32, 3),
        ("count", np.int32),
    ]
)

# The same node as eight 4-byte lanes, for compiled loops that move whole rows.
NODE_LANES = 8
NODE_FIRST = 3
NODE_MAX = 4
NODE_COUNT = 7

# A node of the `bvh2` device layout: 64 bytes, one cache line, both child boxes in the parent, so that one load
# decides about two children. Index 0 is the left child, 1 the right one. `count[i] > 0`: child i is a leaf over
# the triangles first[i] to first[i] + count[i]; `count[i] == 0`: it is the node at first[i].
BVH2_NODE = np.dtype(
    [
        ("aabb_min", np.float32, (2, 3)),
        ("aabb_max", np.float32, (2, 3)),
        ("first", np.int32, 2),
        ("count", np.int32, 2),
    ]
)

# The same node as 4-byte lanes; a field's lanes of child i begin at FIELD + i * its length.
BVH2_LANES = 16
BVH2_MIN = 0
BVH2_MAX = 6
BVH2_FIRST = 12
BVH2_COUNT = 14

# A node of the `bvh4` and `bvh8` device layouts: the boxes of all children, one after the other for each coordinate, so
# that a vector unit takes a coordinate of all of them at once. `child[i] >= 0` is the number of a node, another one is
# the complement (`~child[i]`) of the number of a leaf's group. A child that is not there has its box turned inside out.
WIDE_NODES = {
    width: np.dtype(
        [
            ("aabb_min", np.float32, (3, width)),
            ("aabb_max", np.float32, (3, width)),
            ("child", np.int32, width),
        ]
    )
    for width in (4, 8)
}

# The triangles of a leaf in the same way: `corners[i][axis]` is a coordinate of corner i of all of them. Lanes without
# a triangle, and those of degenerate ones, are NaN, which no ray hits.
GROUPS = {width: np.dtype([("corners", np.float32, (3, 3, width)), ("prim_id", np.int32, width)]) for width in (4, 8)}

# A triangle in leaf order, with the number of its face in the mesh. A degenerate triangle is stored with three
# equal corners: that makes its determinant exactly zero, so that no rounding can let a ray hit it.
TRIANGLE = np.dtype(
    [
        ("a", np.float32, 3),
        ("b", np.float32, 3),
        ("c", np.float32, 3),
        ("prim_id", np.int32),
    ]
)

# A ray relative to the mesh's origin. The direction has any length above zero; t counts in its units.
RAY = np.dtype(
    [
        ("origin", np.float32, 3),
        ("t_min", np.float32),
        ("direction", np.float32, 3),
        ("t_max", np.float32),
    ]
)

# A hit at (1 - u - v) a + u b + v c. On a miss t is infinite and prim_id is NO_PRIM.
HIT = np.dtype(
    [
        ("t", np.float32),
        ("u", np.float32),
        ("v", np.float32),
        ("prim_id", np.int32),
    ]
)

# Everything one picture needs besides the mesh. Colours are linear, from 0 to 1.
VIEW = np.dtype(
    [
        # A pixel's ray starts at `eye`, relative to the mesh's origin, along forward + x * right + y * up with x and
        # y from -1 to 1. `forward` is a unit vector; the others are as long as half the picture at distance 1.
        ("eye", np.float32, 3),
        ("forward", np.float32, 3),
        ("right", np.float32, 3),
        ("up", np.float32, 3),
        # The light comes from one direction, a unit vector towards it, and evenly from the sky and the ground.
        ("to_light", np.float32, 3),
        ("light_colour", np.float32, 3),
        ("to_sky", np.float32, 3),
        ("sky_colour", np.float32, 3),
        ("ground_colour", np.float32, 3),
        ("surface_colour", np.float32, 3),
        ("background_top", np.float32, 3),
        ("background_bottom", np.float32, 3),
        # Distances along `forward` that the depth picture shows as white and as black.
        ("depth_near", np.float32),
        ("depth_far", np.float32),
        ("width", np.int32),
        ("height", np.int32),
        ("shading", np.int32),
    ]
)

# The same triangle as 4-byte lanes: nine coordinates, then the number.
TRIANGLE_LANES = 10
TRIANGLE_PRIM_ID = 9

# Structs by their C names, in the order in which they are declared.
DEVICE_STRUCTS = {
    "bvh2_node_t": BVH2_NODE,
    "triangle_t": TRIANGLE,
    "bvh4_node_t": WIDE_NODES[4],
    "bvh8_node_t": WIDE_NODES[8],
    "group4_t": GROUPS[4],
    "group8_t": GROUPS[8],
    "ray_t": RAY,
    "hit_t": HIT,
    "view_t": VIEW,
}

NO_PRIM = -1

# What `view.shading` may say.
SHADINGS = {"lambert": 0, "lambert+shadow": 1, "normal": 2, "depth": 3}

# How a tree lies in the device's memory; `brute` is no tree at all.
LAYOUTS = {"bvh2": 0, "brute": 1, "bvh4": 2, "bvh8": 3}

# Children of a node, at most, by layout; and in the wide layouts triangles of a group.
LAYOUT_WIDTHS = {"bvh2": 2, "bvh4": 4, "bvh8": 8}

# Those in which the rays of a tile begin at a node of their own, see cl/entry.cl: two children would be too few for it.
ENTRY_LAYOUTS = ("bvh4", "bvh8")

DEVICE_CONSTANTS = {
    "NO_PRIM": NO_PRIM,
    **{"LAYOUT_" + name.upper(): number for name, number in LAYOUTS.items()},
    **{"SHADE_" + name.upper().replace("+", "_"): number for name, number in SHADINGS.items()},
}

_C_TYPES = {np.dtype(np.float32): "float", np.dtype(np.int32): "int", np.dtype(np.uint32): "uint"}


def c_declarations() -> str:
    """Return the OpenCL C text of the constants and of all structs.

    Every field is a 4-byte scalar or an array of them, so a C compiler adds no padding and the struct is the same
    on every device, whatever its alignment rules.
    """
    lines = [f"#define {name} ({value})" for name, value in DEVICE_CONSTANTS.items()]
    for name, dtype in DEVICE_STRUCTS.items():
        lines += [
            "typedef struct {",
            *(f"    {_c_field(dtype, field)};" for field in dtype.names or ()),
            f"}} {name};",
        ]
    return "\n".join(lines) + "\n"


def _c_field(struct: np.dtype, name: str) -> str:
    """Return one field's declaration, such as ``float aabb_min[2][3]``."""
    dtype = struct[name]
    dimensions = "".join(f"[{size}]" for size in dtype.shape)
    return f"{_C_TYPES[dtype.base]} {name}{dimensions}"
