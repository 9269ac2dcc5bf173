// The slab test of aabb.cl for all children of a node of the `bvh4` and `bvh8` layouts, in lanes.
//
// Where a ray crosses a plane is plane * inverse + shift here, one step instead of two on the way from node to node: the
// product origin * inverse is the same for all planes. What it rounds off is an absolute error, so each shift moves its
// side out by more: a rounding of that product, one of the shift, one of plane * inverse where no instruction fuses both
// steps, and what underflow loses. SLAB_SLACK covers the relative errors, which are fewer than there.

#include "aabb.cl"
#include "lanes.cl"

#define SHIFT_SLACK ERROR_BOUND(4)

// Shifts above this may come from an infinity, or lead to one: 0 * infinity and infinity - infinity are NaN.
#define MOST_SHIFT 0x1p100f

// For rays with such shifts, distances are counted in a unit in which the inverse direction is from this number to twice
// as much on the longest axis, and limited to the other one on the rest. Then no product overflows.
#define LEAST_INVERSE 0x1p-36f
#define MOST_INVERSE 0x1p-4f

// Where in a node the rows are with the near and the far sides of the boxes along x, y and z, as offsets, so that nothing
// is chosen at each node; and what makes planes, and limits, distances along the ray.
typedef struct {
    int3 near;
    int3 far;
    float3 inverse_near;
    float3 inverse_far;
    float3 shift_near;
    float3 shift_far;
    float t_min;
    float limit_scale;  // with the slack
} sides_t;

INLINED void derive_shifts(sides_t *sides, const float3 origin, const float3 inverse, const float3 least_slack)
{
    sides->inverse_near = inverse;
    sides->inverse_far = inverse * SLAB_SLACK;
    const float3 near = origin * sides->inverse_near;
    const float3 far = origin * sides->inverse_far;
    const float3 slack = magnitude(far) * SHIFT_SLACK + least_slack;
    sides->shift_near = -near - slack;
    sides->shift_far = -far + slack;
}

// The largest coordinate in a node. A child that is not there, inside out, has only negative ones here.
INLINED float largest_coordinate(const global node_t *node)
{
    lanes_t largest = (lanes_t)(0.0f);
    for (int axis = 0; axis < 3; axis++) {
        const lanes_t below = -load_lanes(node->aabb_min[axis]);
        const lanes_t above = load_lanes(node->aabb_max[axis]);
        largest = larger_lanes(largest, larger_lanes(below, above));
    }
    return largest_of_lanes(largest);
}

// The same in the other unit. Along an axis with a limited inverse the ray hardly moves: while it crosses the mesh, by
// less than a 2^-30th of its size. A box does not end where the ray is in its face, so there all sides are moved out by
// more than the ray's whole way through the mesh.
INLINED void limit_shifts(sides_t *sides, const global node_t *root, const path_t *path)
{
    // A power of two, so that it rounds nothing.
    const float unit = LEAST_INVERSE / as_float(as_int(path->shear.z) & 0x7f800000);
    const float3 inverse = path->inverse * unit;
    const int3 is_steep = magnitude(inverse) > MOST_INVERSE;
    const float3 limited = inverse < 0.0f ? (float3)(-MOST_INVERSE) : (float3)(MOST_INVERSE);
    // What is beyond float32 hits nothing, but the way through the tree has to end.
    const float3 origin = magnitude(path->origin) <= FLT_MAX ? path->origin : (float3)(FLT_MAX);
    const float3 away = magnitude(origin);
    const float size = larger(larger(away.x, away.y), larger(away.z, largest_coordinate(root)));
    // The way is at most 2 * size * 2 * LEAST_INVERSE, and rounded. Written so that it is finite.
    const float3 least_slack = is_steep ? (float3)(8.0f * LEAST_INVERSE * size) : (float3)(FLT_MIN);
    derive_shifts(sides, origin, is_steep ? limited : inverse, least_slack);
    sides->t_min = path->t_min * unit;
    sides->limit_scale = unit * SLAB_SLACK;
}

INLINED sides_t make_sides(const global node_t *root, const path_t *path)
{
    sides_t sides;
    derive_shifts(&sides, path->origin, path->inverse, (float3)(FLT_MIN));
    sides.t_min = path->t_min;
    sides.limit_scale = SLAB_SLACK;
    const float3 size = magnitude(sides.shift_far);
    if (!(size.x + size.y + size.z <= MOST_SHIFT)) {
        limit_shifts(&sides, root, path);
    }
    // The minima are rows 0 to 2, the maxima rows 3 to 5.
    const int3 is_back = path->inverse < 0.0f;
    const int3 axis = (int3)(0, 1, 2);
    sides.near = WIDTH * (axis + (is_back & 3));
    sides.far = WIDTH * (axis + (~is_back & 3));
    return sides;
}

INLINED lanes_t cross_planes(const global float *planes, const float inverse, const float shift)
{
    return MULTIPLY_ADD_LANES(load_lanes(planes), (lanes_t)(inverse), (lanes_t)(shift));
}

// Returns a bit for each child that the ray meets before `limit`, which is scaled already.
INLINED uint meets_children(const global node_t *node, const sides_t *sides, const float limit, lanes_t *entry)
{
    const global float *rows = (const global float *)node;
    const lanes_t enter_x = cross_planes(rows + sides->near.x, sides->inverse_near.x, sides->shift_near.x);
    const lanes_t enter_y = cross_planes(rows + sides->near.y, sides->inverse_near.y, sides->shift_near.y);
    const lanes_t enter_z = cross_planes(rows + sides->near.z, sides->inverse_near.z, sides->shift_near.z);
    const lanes_t leave_x = cross_planes(rows + sides->far.x, sides->inverse_far.x, sides->shift_far.x);
    const lanes_t leave_y = cross_planes(rows + sides->far.y, sides->inverse_far.y, sides->shift_far.y);
    const lanes_t leave_z = cross_planes(rows + sides->far.z, sides->inverse_far.z, sides->shift_far.z);
    // In pairs: the next node waits for these comparisons.
    *entry = larger_lanes(larger_lanes(enter_x, enter_y), larger_lanes(enter_z, (lanes_t)(sides->t_min)));
    const lanes_t leave = smaller_lanes(smaller_lanes(leave_x, leave_y), smaller_lanes(leave_z, (lanes_t)(limit)));
    return mask_bits(*entry <= leave);
}
