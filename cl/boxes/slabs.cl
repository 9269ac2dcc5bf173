// The slab test of boxes/aabb.cl for all children of a node of the `bvh4` and `bvh8` layouts, in lanes.
//
// The t of a plane is plane * inverse + shift with shift = -origin * inverse, computed once per ray: one step instead
// of two on the critical path from node to node. The rounding of the shift is an absolute error of t, so each shift
// moves its plane outwards by more: one rounding of the product, one of the shift, one of plane * inverse where no
// instruction fuses both steps, and the loss by underflow. SLAB_SLACK covers the relative errors, which are fewer than
// in boxes/aabb.cl.

#include "boxes/aabb.cl"
#include "math/lanes.cl"

#define SHIFT_SLACK ERROR_BOUND(4)

// A larger shift may result from an infinity or lead to one: 0 * infinity and infinity - infinity are NaN.
#define MAX_SHIFT 0x1p100f

// Rays with larger shifts measure t in a unit that puts the inverse of the largest component of the direction between
// MIN_INVERSE and 2 * MIN_INVERSE. The inverses of the other components are clamped to MAX_INVERSE. No product
// overflows.
#define MIN_INVERSE 0x1p-36f
#define MAX_INVERSE 0x1p-4f

// A ray as the slab test needs it. The offsets are those of the near and the far planes in a node, per axis: the signs
// of the direction select them once per ray, so that no node takes a branch.
typedef struct {
    int3 near_offset;
    int3 far_offset;
    float3 near_inverse;
    float3 far_inverse;
    float3 near_shift;
    float3 far_shift;
    float t_min;
    float limit_scale;  // turns t of the ray into the limit of meets_children, slack included
} slabs_t;

// `min_slack` is added to the slack of all planes.
INLINED void derive_shifts(slabs_t *slabs, const float3 origin, const float3 inverse, const float3 min_slack)
{
    slabs->near_inverse = inverse;
    slabs->far_inverse = inverse * SLAB_SLACK;
    const float3 near = origin * slabs->near_inverse;
    const float3 far = origin * slabs->far_inverse;
    const float3 slack = magnitude(far) * SHIFT_SLACK + min_slack;
    slabs->near_shift = -near - slack;
    slabs->far_shift = -far + slack;
}

// The largest absolute coordinate of a node's boxes. A missing child, whose box is inverted, counts as negative.
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

// Derives the shifts in the other unit. Along an axis with a clamped inverse the ray moves by less than 2^-30 of the
// mesh's size while it crosses the mesh. A ray in a face must not t_far the box there, so on these axes all planes are
// moved outwards by more than the t of the whole way through the mesh.
INLINED void limit_shifts(slabs_t *slabs, const global node_t *root, const ray_t *ray)
{
    // A power of two: scaling by it is exact.
    const float unit = MIN_INVERSE / as_float(as_int(ray->shear.z) & 0x7f800000);
    const float3 inverse = ray->inverse * unit;
    const int3 is_clamped = magnitude(inverse) > MAX_INVERSE;
    const float3 clamped = inverse < 0.0f ? (float3)(-MAX_INVERSE) : (float3)(MAX_INVERSE);
    // An origin beyond float32 hits nothing, but the traversal has to end.
    const float3 origin = magnitude(ray->origin) <= FLT_MAX ? ray->origin : (float3)(FLT_MAX);
    const float3 away = magnitude(origin);
    const float size = larger(larger(away.x, away.y), larger(away.z, largest_coordinate(root)));
    // The way is at most 2 * size * 2 * MIN_INVERSE, plus rounding. Multiplied in this order the product is finite.
    const float3 min_slack = is_clamped ? (float3)(8.0f * MIN_INVERSE * size) : (float3)(FLT_MIN);
    derive_shifts(slabs, origin, is_clamped ? clamped : inverse, min_slack);
    slabs->t_min = ray->t_min * unit;
    slabs->limit_scale = unit * SLAB_SLACK;
}

INLINED slabs_t make_slabs(const global node_t *root, const ray_t *ray)
{
    slabs_t slabs;
    derive_shifts(&slabs, ray->origin, ray->inverse, (float3)(FLT_MIN));
    slabs.t_min = ray->t_min;
    slabs.limit_scale = SLAB_SLACK;
    const float3 size = magnitude(slabs.far_shift);
    if (!(size.x + size.y + size.z <= MAX_SHIFT)) {
        limit_shifts(&slabs, root, ray);
    }
    // A node begins with six planes of WIDTH lanes each: the minima along x, y and z, then the maxima.
    const int3 is_backward = ray->inverse < 0.0f;
    const int3 axis = (int3)(0, 1, 2);
    slabs.near_offset = WIDTH * (axis + (is_backward & 3));
    slabs.far_offset = WIDTH * (axis + (~is_backward & 3));
    return slabs;
}

INLINED lanes_t cross_planes(const global float *planes, const float inverse, const float shift)
{
    return MULTIPLY_ADD_LANES(load_lanes(planes), (lanes_t)(inverse), (lanes_t)(shift));
}

// Returns one bit per child, set where the ray meets the child's box before `limit`, which is scaled by limit_scale.
// *t_near has the t at which the ray enters each box.
INLINED uint meets_children(
    const global node_t *node, const slabs_t *slabs, const float limit, lanes_t *t_near)
{
    const global float *planes = (const global float *)node;
    const lanes_t near_x = cross_planes(planes + slabs->near_offset.x, slabs->near_inverse.x, slabs->near_shift.x);
    const lanes_t near_y = cross_planes(planes + slabs->near_offset.y, slabs->near_inverse.y, slabs->near_shift.y);
    const lanes_t near_z = cross_planes(planes + slabs->near_offset.z, slabs->near_inverse.z, slabs->near_shift.z);
    const lanes_t far_x = cross_planes(planes + slabs->far_offset.x, slabs->far_inverse.x, slabs->far_shift.x);
    const lanes_t far_y = cross_planes(planes + slabs->far_offset.y, slabs->far_inverse.y, slabs->far_shift.y);
    const lanes_t far_z = cross_planes(planes + slabs->far_offset.z, slabs->far_inverse.z, slabs->far_shift.z);
    // Compared in pairs: a tree of comparisons is shorter than a chain, and the choice of the next node waits for it.
    *t_near = larger_lanes(larger_lanes(near_x, near_y), larger_lanes(near_z, (lanes_t)(slabs->t_min)));
    const lanes_t t_far = smaller_lanes(smaller_lanes(far_x, far_y), smaller_lanes(far_z, (lanes_t)(limit)));
    return mask_bits(*t_near <= t_far);
}
