"""Every struct that crosses to a device, once: numpy dtypes, named lanes, constants, and the C text made from them.

Host arrays use the dtypes. Compiled loops access the same memory as 4-byte lanes, whose indices are derived from the
dtypes. Kernels include the text of `c_declarations`; a test writes a different value into every field and reads it back
on each device.
"""

from __future__ import annotations

import math

import numpy as np

from .choices import MAX_BINS, MAX_LEAF_SIZE, SHADINGS, TONE_CURVES
from .kinds import KINDS, TRIANGLES, Kind
from .tree_layouts import LAYOUT_STRUCTS, LAYOUTS, WIDE_WIDTHS

_LANE_BYTES = 4


def _lane(struct: np.dtype, field: str) -> int:
    """Return the first lane of a field."""
    return int(struct.fields[field][1]) // _LANE_BYTES  # type: ignore[index]


def _lane_count(struct: np.dtype) -> int:
    return struct.itemsize // _LANE_BYTES


# --- Trees on the host ---

# A node of a finished tree: 32 bytes. `count > 0` is a leaf over prim_ids[first : first + count]; `count == 0` is an
# interior node with its children at `first` and `first + 1`.
NODE = np.dtype([("aabb_min", "f4", 3), ("first", "i4"), ("aabb_max", "f4", 3), ("count", "i4")])
NODE_LANES = _lane_count(NODE)
NODE_FIRST = _lane(NODE, "first")
NODE_COUNT = _lane(NODE, "count")

# An aabb in a vector register, and in the builders' arrays. The maximum is negated, so that one eight-lane minimum
# unites two boxes; the minimum leaves garbage in the tag and in the tally, whose meaning is up to each array.
BOX = np.dtype([("aabb_min", "f4", 3), ("tag", "i4"), ("negated_max", "f4", 3), ("tally", "i4")])
BOX_LANES = _lane_count(BOX)
BOX_TAG = _lane(BOX, "tag")
BOX_NEGATED_MAX = _lane(BOX, "negated_max")
BOX_TALLY = _lane(BOX, "tally")

# A leaf never lies deeper. Builders keep the promise by construction: as soon as a node's primitives need all levels
# that are left, they split by halves. Spatial splits of real meshes stay below 40.
MAX_DEPTH = 64

# Up to how many primitives of a node the default builder tries all divisions in two: four have 7, five 15.
MAX_EXHAUSTIVE = 4

# --- Trees on the device; their nodes and primitives: see `tree_layouts.py` ---

# Blocks of the `bvh8c` layout; see `layouts/shared_blocks.py`.
SHARED_HEADER = 4  # words before the vertices of a block
SHARED_VERTEX_BITS = 4
MOST_SHARED_VERTICES = 1 << SHARED_VERTEX_BITS

# --- Trees that a device builds, see cl/tree ---

# Two clusters that became one: a node of the binary tree. Clusters are numbered from 0 in the order in which they were
# made; `~i` is the i-th primitive along the curve. `interior_count` is that of the subtree, 0 where it is a leaf.
MERGE = np.dtype(
    [
        ("aabb_min", "f4", 3), ("left", "i4"), ("aabb_max", "f4", 3), ("right", "i4"),
        ("cost", "f4"), ("prim_count", "i4"), ("interior_count", "i4"), ("height", "i4"),
    ]
)  # fmt: skip

# A subtree as at most 1, 2, ... children of a wide node: its cost, and four bits each for the children that the left
# half has, 0 where one child less is as cheap; see `layouts/wide.py`.
WIDE_CHOICES = {width: np.dtype([("cost", "f4", width), ("shares", "u4")]) for width in WIDE_WIDTHS}

# Where a node of the binary tree goes: its index, the first index for the nodes below it, the first one for blocks or
# primitives, and the entries that a traversal has on its stack before. Of the wide layouts, until a node is placed, the
# numbers of nodes and blocks of its subtree.
PLACEMENT = np.dtype([("node", "i4"), ("next_node", "i4"), ("next_block", "i4"), ("on_stack", "i4")])

# What the host must know of a tree: its sizes, the size of a traversal's stack, and the box.
TREE_SUMMARY = np.dtype(
    [("aabb_min", "f4", 3), ("node_count", "i4"), ("aabb_max", "f4", 3), ("block_count", "i4"), ("stack_size", "i4")]
)

# --- Queries ---

# A ray as it is uploaded, in local coordinates. The longest component of the direction is from 1 to 2; the unit of t is
# the direction's length.
PACKED_RAY = np.dtype([("origin", "f4", 3), ("t_min", "f4"), ("direction", "f4", 3), ("t_max", "f4")])

# An origin within this many times half the box's size is not advanced, see cl/rays/pack.cl.
NEAR_SHARE = 8.0

# A point farther away than this many times half the box's size is moved to that distance, towards the centre. From
# there on, the closest triangle depends on little but the direction: by half of half the size over this number. A
# larger one would cost more in float32: sixteen roundings of it are as much.
FAR_POINT_SHARE = 512.0

# A hit at (1 - u - v) a + u b + v c. On a miss t is infinite and prim_id is NO_PRIM.
HIT = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4")])

# The steps of a ray's way to its closest hit, over both levels of the world, and that hit; see `count_steps`.
STEPS = np.dtype([("node_steps", "i4"), ("leaf_visits", "i4"), ("prim_tests", "i4"), ("prim_id", "i4")])

# --- Scenes ---

# What float32 has rounded off the origin and the direction of a packed ray in a scene, and the ray's mask: only the
# instances whose mask shares a bit with it are visible. The rays of a camera share one.
RAY_LOW = np.dtype([("origin", "f4", 3), ("mask", "u4"), ("direction", "f4", 3), ("spare", "f4")])

# A point as it is uploaded, in local coordinates, and what float32 has rounded off it. Only the instances whose mask
# shares a bit with the point's are visible to it; a lone shape is to all masks but 0, and uses no low part. What is
# farther away than the limit, rounded up, is not looked for.
PACKED_POINT = np.dtype([("position", "f4", 3), ("mask", "u4"), ("position_low", "f4", 3), ("limit", "f4")])

# A placed geometry: 128 bytes, two cache lines. Matrices are by rows.
INSTANCE = np.dtype(
    [
        # The linear part of the map from the scene's local coordinates to the geometry's.
        ("to_object", "f4", (3, 3)),
        # The zero of the geometry's local coordinates in the scene's, and what float32 has rounded off it.
        ("centre", "f4", 3),
        ("centre_low", "f4", 3),
        # No point of the geometry is farther from the centre, in the scene's local coordinates.
        ("radius", "f4"),
        # The linear part of the map from the geometry's local coordinates to the scene's.
        ("to_world", "f4", (3, 3)),
        # Where the geometry's nodes and blocks begin, and how many blocks it has.
        ("first_node", "i4"),
        ("first_block", "i4"),
        ("block_count", "i4"),
        # The number of a `Kind`.
        ("kind", "i4"),
        ("mask", "u4"),
        ("instance_id", "i4"),
        ("spare", "i4"),
    ]
)

# What distances within an instance need of its matrix, see clbvh/trace/world/metrics.py. Lengths are in the scene's
# local coordinates, for one unit of the geometry's. Matrices are by rows.
METRIC = np.dtype(
    [
        # Rotated axes: unit vectors, in which the map from the geometry is triangular.
        ("turn", "f4", (3, 3)),
        # The diagonal of the triangular matrix, not negative; and above it: of y to x, of z to x and of z to y.
        ("stretch", "f4", 3),
        ("shear", "f4", 3),
        ("is_sheared", "i4"),
        # The sum of all entries of the map.
        ("reach", "f4"),
        # The ellipsoid that the map makes of a sphere of radius 1: unit vectors, and half lengths along them. Only of
        # spheres.
        ("axes", "f4", (3, 3)),
        ("half_lengths", "f4", 3),
        # Whether it is a sphere.
        ("keeps_spheres", "i4"),
        ("spare", "i4", 2),
    ]
)

# Of worlds that span scales, see cl/exact/ray.cl: a ray in the world's local coordinates, and its mask.
EXACT_RAY = np.dtype([("origin", "f8", 3), ("direction", "f8", 3), ("mask", "u4"), ("spare", "u4")])

# And an instance. Matrices are by rows.
EXACT_INSTANCE = np.dtype(
    [
        # The linear parts of the maps from the geometry's local coordinates to the world's and back, and the zero of
        # the geometry's in the world's.
        ("to_world", "f8", (3, 3)),
        ("centre", "f8", 3),
        ("to_object", "f8", (3, 3)),
        # How far float64 may move a point by the map to the geometry, per unit of its distance there; and the most
        # units that one of the world's has there.
        ("rounding", "f8"),
        ("stretch", "f8"),
        # Zero and unit of the geometry's local coordinates in the coordinates of its file.
        ("origin", "f8", 3),
        ("scale", "f8"),
        # Where the geometry's vertices, faces and numbers of solids begin.
        ("first_vertex", "i8"),
        ("first_face", "i8"),
        ("first_solid", "i8"),
    ]
)

# A ray that begins farther away than this many radii of an instance is advanced to just before it.
FAR_RADII = 32

# Where the rays of a tile begin in a scene, see cl/instances/start.cl.
MAX_TILE_LEAVES = 14

# Rays of a tile that the host casts together, at most, see cl/on_host/world/rays.cl.
MOST_TILE_RAYS = 64

TILE = np.dtype(
    [
        # Leaves that the tile's beam meets, as slots 2 * node + child; or -1: its rays traverse the tree over the
        # instances from `top_node` on.
        ("leaf_count", "i4"),
        ("top_node", "i4"),
        # The only instance that the rays can hit, which they enter without a test; or -1.
        ("instance_index", "i4"),
        ("spare", "i4"),
        ("leaf", "i4", MAX_TILE_LEAVES),
        # The least t at which a ray of the tile may enter the leaf's box, in ascending order.
        ("t_near", "f4", MAX_TILE_LEAVES),
    ]
)

# A hit in a scene. The prim_id counts within the geometry. Of a sphere, u is 0 where the ray enters and 1 where it
# leaves.
WORLD_HIT = np.dtype(
    [
        ("t", "f4"),
        ("u", "f4"),
        ("v", "f4"),
        ("prim_id", "i4"),
        ("instance_id", "i4"),
        # The t inside the instance, which is finer where the ray has been advanced to it.
        ("t_inside", "f4"),
    ]
)

# A primitive of an instance, both NO_PRIM where there is none.
WORLD_PRIM = np.dtype([("prim_id", "i4"), ("instance_id", "i4")])

# A point over which rays are drawn, with the unit normal around which they are, in local coordinates: a scene point,
# the length of the rays, and the number of the point, from which its samples are derived. Without a scene, what float32
# has rounded off the position and the mask are not used.
HEMISPHERE = np.dtype(
    [
        ("position", "f4", 3),
        ("mask", "u4"),
        ("position_low", "f4", 3),
        ("t_max", "f4"),
        ("normal", "f4", 3),
        ("number", "u4"),
    ]
)

# --- Pictures ---

# The parameters of a picture besides the mesh. Colours are linear, from 0 to 1.
VIEW = np.dtype(
    [
        # A perspective ray starts at `eye`, in local coordinates, along forward + x * right + y * up with x and y
        # from -1 to 1. `forward` points to the middle of the picture's plane at distance 1 from the eye; `right` and
        # `up` are half its size. They are at right angles unless the lens is off centre or has skew. The other
        # projections have them, too, see cl/rays/camera.cl.
        ("eye", "f4", 3),
        ("forward", "f4", 3),
        ("right", "f4", 3),
        ("up", "f4", 3),
        # The unit vector along which depth is measured.
        ("optical_axis", "f4", 3),
        # Directed light, with a unit vector towards it, and ambient light from the sky and the ground.
        ("to_light", "f4", 3),
        ("light_colour", "f4", 3),
        ("to_sky", "f4", 3),
        ("sky_colour", "f4", 3),
        ("ground_colour", "f4", 3),
        ("surface_colour", "f4", 3),
        ("background_top", "f4", 3),
        ("background_bottom", "f4", 3),
        # Distances along `optical_axis` that a depth picture shows as white and as black.
        ("depth_near", "f4"),
        ("depth_far", "f4"),
        ("width", "i4"),
        ("height", "i4"),
        ("shading", "i4"),
        # The ground of a picture: a plane through a point, with a unit normal, seen up to a distance from the point.
        # A radius of 0: there is none.
        ("ground_point", "f4", 3),
        ("ground_normal", "f4", 3),
        ("ground_radius", "f4"),
        # A box and a ball around all objects: rays that come near neither are not stopped.
        ("objects_centre", "f4", 3),
        ("objects_half_size", "f4", 3),
        ("objects_radius", "f4"),
        # Tangent of half the angle under which the directed light is seen: soft shadows.
        ("light_spread", "f4"),
        # The same light of `path`: 1 - cos of half that angle, 0 for a light without size.
        ("sun_width", "f4"),
        # Whether the directed light of `studio` comes from the eye, without shadows: objects are all around it.
        ("is_headlight", "i4"),
        # Whether `path` is lit as `studio`: by the light of sky and ground, and not by the background.
        ("is_studio_lit", "i4"),
        # Occlusion is searched for up to here, in local units.
        ("occlusion_reach", "f4"),
        # Light is multiplied by it before it becomes a colour.
        ("exposure", "f4"),
        # One of TONE_CURVES.
        ("tone_curve", "i4"),
        ("is_transparent", "i4"),
        # Of the sample points.
        ("seed", "u4"),
        ("most_bounces", "i4"),
        # Samples of `path` are limited to it; inf where none is.
        ("most_light", "f4"),
        # The light that paths draw: whether there is directed light, how many emitting primitives there are, and the
        # sum of their luminance times area, in local units.
        ("has_sun", "i4"),
        ("light_count", "i4"),
        ("light_power", "f4"),
        # Pixels of the environment, 0 where there is none; and the unit vectors to the right of its middle, and to it.
        ("environment_width", "i4"),
        ("environment_height", "i4"),
        ("environment_right", "f4", 3),
        ("environment_front", "f4", 3),
        # Factor of its light.
        ("environment_strength", "f4"),
        # What float32 has rounded off the eye and off `forward`: used in scenes, whose instances may be far away.
        ("eye_low", "f4", 3),
        ("forward_low", "f4", 3),
        # One of PROJECTIONS.
        ("projection", "i4"),
        # The lens of depth of field, if there is one: its halves to the right and upwards, in local units, and 1 / its
        # distance to the plane of focus.
        ("has_lens", "i4"),
        ("lens_right", "f4", 3),
        ("lens_up", "f4", 3),
        ("inverse_focus", "f4"),
        # The picture in the plane of its projection, see clbvh/views/cameras/lens.py.
        ("centre", "f4", 2),
        ("half_size", "f4", 2),
        ("shear", "f4"),
        # Of a fisheye, from the middle to the circle: turns.
        ("half_angle", "f4"),
        # k1, k2, p1, p2 and k3 of OpenCV.
        ("distortion", "f4", 5),
        # One of CUTS, or 0. Of a plane the unit normal, and how far the eye is on its side; of a box the corners, from
        # the eye. In local units.
        ("cut", "i4"),
        ("cut_normal", "f4", 3),
        ("cut_height", "f4"),
        ("cut_lower", "f4", 3),
        ("cut_upper", "f4", 3),
        # Whether a cut shows sections of closed objects, their colour, in the kind of numbers that the shading has,
        # and pixels from one line of their hatching to the next, or 0.
        ("has_section", "i4"),
        ("section_colour", "f4", 3),
        ("section_hatch", "i4"),
        # Lines along the edges of triangles: their width in pixels, and their colour, in the kind of numbers that the
        # shading computes.
        ("line_width", "f4"),
        ("line_colour", "f4", 3),
        # Whether a surface has an alpha below 1.
        ("has_cutouts", "i4"),
    ]
)

# How the primitives of an instance look: where their rows begin in the tables of all geometries, or -1. The tables have
# one value for each corner of each triangle; a sphere has one material.
LOOK = np.dtype(
    [
        # Linear; instead of the base colour of the material where `has_colour` is 1.
        ("colour", "f4", 3),
        ("has_colour", "i4"),
        ("first_normal", "i4"),
        # In the same table; -1 also where no material has a texture of normals.
        ("first_tangent", "i4"),
        ("first_colour", "i4"),
        ("first_uv", "i4"),
        ("first_material_id", "i4"),
        # Of all primitives, where `first_material_id` is -1.
        ("material_id", "i4"),
        # Whether its emitting primitives are among the lights that paths draw.
        ("is_light", "i4"),
    ]
)

# A material, with the meanings of glTF 2.0. Textures are indices, or -1.
MATERIAL = np.dtype(
    [
        # Linear.
        ("base_colour", "f4", 3),
        ("alpha", "f4"),
        ("emission", "f4", 3),
        # An alpha below it is no surface, any other is opaque; -1: the alpha is a share of covered area.
        ("alpha_cutoff", "f4"),
        ("metallic", "f4"),
        ("roughness", "f4"),
        ("ior", "f4"),
        # The share of light that goes through: 1 is glass.
        ("transmission", "f4"),
        ("base_colour_texture", "i4"),
        ("metallic_roughness_texture", "i4"),
        ("emission_texture", "i4"),
        ("normal_texture", "i4"),
        ("normal_scale", "f4"),
        # Whether paths may draw its light: neither textures nor alpha change it.
        ("is_light", "i4"),
    ]
)

# A texture: rows of texels from the top, 8-bit red, green, blue and alpha in one uint.
TEXTURE = np.dtype(
    [
        ("first_texel", "i4"),
        ("width", "i4"),
        ("height", "i4"),
        # One of TEXTURE_WRAPS, along u and along v.
        ("wrap", "i4", 2),
        ("is_srgb", "i4"),
        # Whether texels are squares, and not interpolated.
        ("is_nearest", "i4"),
    ]
)

# A primitive that emits light, in local coordinates: a triangle with corner a and two edges, or a sphere around a.
LIGHT = np.dtype(
    [
        ("a", "f4", 3),
        # 0: a triangle.
        ("radius", "f4"),
        ("ab", "f4", 3),
        ("ac", "f4", 3),
        # A unit vector, on either side.
        ("normal", "f4", 3),
        # Linear.
        ("emission", "f4", 3),
        # With which a point of the primitive is drawn, of those of all emitting primitives, per area.
        ("density", "f4"),
    ]
)

# The choice of an emitting primitive by its power, see cl/film/choice.cl.
LIGHT_CHOICE = np.dtype(
    [
        # Of a fixed-point fraction: below it, the primitive of this index is chosen.
        ("threshold", "u4"),
        # The primitive that is chosen otherwise.
        ("alias", "i4"),
    ]
)

# --- The same in C ---

# Structs by their C names, in the order of their declarations.
DEVICE_STRUCTS = {
    "row_node_t": NODE,
    **LAYOUT_STRUCTS,
    "merge_t": MERGE,
    **{f"choice{width}_t": WIDE_CHOICES[width] for width in WIDE_WIDTHS},
    "placement_t": PLACEMENT,
    "tree_summary_t": TREE_SUMMARY,
    "packed_ray_t": PACKED_RAY,
    "hit_t": HIT,
    "steps_t": STEPS,
    "ray_low_t": RAY_LOW,
    "instance_t": INSTANCE,
    "metric_record_t": METRIC,
    "packed_point_t": PACKED_POINT,
    "hemisphere_t": HEMISPHERE,
    "tile_t": TILE,
    "world_hit_t": WORLD_HIT,
    "world_prim_t": WORLD_PRIM,
    "view_t": VIEW,
    "look_t": LOOK,
    "material_t": MATERIAL,
    "texture_t": TEXTURE,
    "light_t": LIGHT,
    "light_choice_t": LIGHT_CHOICE,
}

# Those with doubles, which a device need not have: kernels are compiled with them where EXACT is 1.
EXACT_STRUCTS = {"packed_exact_ray_t": EXACT_RAY, "exact_instance_t": EXACT_INSTANCE}

NO_PRIM = -1

# In the place of the normal at the first corner of a face whose corners have the face's own normal: no packed one.
FLAT_FACE = 0xFFFFFFFF

# What a texture shows beyond its edges.
TEXTURE_WRAPS = {"repeat": 0, "clamp": 1, "mirror": 2}

# How the points of a picture become rays; `distorted` is perspective with the distortion of a lens.
CUTS = {"plane": 1, "box": 2}
PROJECTIONS = {"perspective": 0, "distorted": 1, "orthographic": 2, "fisheye": 3, "panorama": 4}

# Samples of the first pass after which the light of cells is compared, see cl/kernels/settle_tiles.cl.
SETTLING_SAMPLES = 8

DEVICE_CONSTANTS = {
    "SETTLING_SAMPLES": SETTLING_SAMPLES,
    "NO_PRIM": NO_PRIM,
    "NEAR_SHARE": NEAR_SHARE,
    "FAR_POINT_SHARE": FAR_POINT_SHARE,
    "MAX_DEPTH": MAX_DEPTH,
    "MAX_BINS": MAX_BINS,
    "MAX_LEAF_SIZE": MAX_LEAF_SIZE,
    "MAX_EXHAUSTIVE": MAX_EXHAUSTIVE,
    "FLAT_FACE": FLAT_FACE,
    "SHARED_HEADER": SHARED_HEADER,
    "SHARED_VERTEX_BITS": SHARED_VERTEX_BITS,
    "FAR_RADII": FAR_RADII,
    "MAX_TILE_LEAVES": MAX_TILE_LEAVES,
    "MOST_TILE_RAYS": MOST_TILE_RAYS,
    **{"KIND_" + name.upper(): kind.number for name, kind in KINDS.items()},
    **{"LAYOUT_" + name.upper(): layout.number for name, layout in LAYOUTS.items()},
    **{"TONE_" + name.upper(): number for name, number in TONE_CURVES.items()},
    **{"WRAP_" + name.upper(): number for name, number in TEXTURE_WRAPS.items()},
    **{"CUT_" + name.upper(): number for name, number in CUTS.items()},
    **{"PROJECTION_" + name.upper(): number for name, number in PROJECTIONS.items()},
    **{"SHADE_" + name.upper().replace("+", "_"): number for name, number in SHADINGS.items()},
}

# Of kernels that are compiled without them, see cl/world/world.cl.
_DEFAULT_MACROS = {"LONE": 1, "KINDS": TRIANGLES.bit, "EXACT": 0}

# Bytes of a vector of four words, the longest load of a GPU.
_LARGEST_ALIGNMENT = 16

_C_TYPES = {
    np.dtype(np.float32): "float",
    np.dtype(np.int32): "int",
    np.dtype(np.uint32): "uint",
    np.dtype(np.float64): "double",
    np.dtype(np.int64): "long",
}

# What the doubles of an exact world are in kernels that have none.
_NO_DOUBLES = ("exact_real_t", *EXACT_STRUCTS)


def c_declarations() -> str:
    """Return the OpenCL C text of the constants and of all structs.

    Every field is a scalar of 4 bytes or an array of them, in `EXACT_STRUCTS` also of 8, and no struct is aligned to
    more than what divides its size: a C compiler adds no padding, and the struct is the same on every device.
    """
    lines = [f"#define {name} ({value})" for name, value in DEVICE_CONSTANTS.items()]
    lines += [f"#ifndef {name}\n#define {name} {value}\n#endif" for name, value in _DEFAULT_MACROS.items()]
    lines += [_kind_macros(kind) for kind in KINDS.values()]
    lines.append("#ifndef ALIGNED\n#define ALIGNED(bytes) __attribute__((aligned(bytes)))\n#endif")
    for name, dtype in DEVICE_STRUCTS.items():
        lines += _c_struct(name, dtype)
    lines += ["#if EXACT", "#pragma OPENCL EXTENSION cl_khr_fp64 : enable", "typedef double exact_real_t;"]
    for name, dtype in EXACT_STRUCTS.items():
        lines += _c_struct(name, dtype)
    lines += ["#else", *(f"typedef int {name};" for name in _NO_DOUBLES), "#endif"]
    return "\n".join(lines) + "\n"


def _kind_macros(kind: Kind) -> str:
    """Return the macros that tell whether kernels meet a kind, and whether a number is its: where there is no other."""
    name, bit = kind.name.upper(), kind.bit
    return (
        f"#define HAS_{name} ((KINDS & {bit}) != 0)\n"
        f"#define IS_{name}(kind) (HAS_{name} && (KINDS == {bit} || (kind) == {kind.number}))"
    )


def _c_struct(name: str, dtype: np.dtype) -> list[str]:
    """Return the lines of a struct's declaration."""
    fields = (f"    {_c_field(dtype, field)};" for field in dtype.names or ())
    return [f"typedef struct {_c_alignment(dtype)}{{", *fields, f"}} {name};"]


def _c_alignment(struct: np.dtype) -> str:
    """Return the attribute that says how structs in a buffer are aligned; it divides their size, so it adds no padding.

    Compilers for NVIDIA's GPUs join loads of neighbouring fields only where they know the alignment. In the arrays of
    the host's loops, which may come from anywhere, there is none, see cl/host/loops.cl.
    """
    alignment = math.gcd(struct.itemsize, _LARGEST_ALIGNMENT)
    return f"ALIGNED({alignment}) " if alignment > _LANE_BYTES else ""


def _c_field(struct: np.dtype, name: str) -> str:
    """Return the declaration of one field, such as ``float aabb_min[2][3]``."""
    dtype = struct[name]
    dimensions = "".join(f"[{size}]" for size in dtype.shape)
    return f"{_C_TYPES[dtype.base]} {name}{dimensions}"
