// The slab test of boxes/aabb.cl for all children of a node of the `bvh4` and `bvh8` layouts, in lanes.
//
// The t of a plane is plane * inverse + shift with shift = -origin * inverse, computed once per ray: one step instead
// of two on the critical path from node to node. The shifts have the padding: in units of t it is the padding's time
// and its distance * inverse.

#include "boxes/padding.cl"
#include "math/lanes.cl"

// A longer way of the padding may result from an infinity or lead to one: 0 * infinity and infinity - infinity are NaN.
#define MAX_SLACK 0x1p78f

// Rays with more measure t in a unit that puts the inverse of the longest component of the direction between
// MIN_INVERSE and 2 * MIN_INVERSE, and those of the other components are limited. No product overflows.
#define MIN_INVERSE 0x1p-36f

// A ray as the slab test needs it. The offsets are those of the near and the far planes in a node, per axis: the signs
// of the direction select them once per ray, so that no node takes a branch.
typedef struct {
    int3 near_offset;
    int3 far_offset;
    float3 inverse;
    float3 near_shift;
    float3 far_shift;
    float t_min;
    float unit;  // turns t of the ray into that of the slabs
} slabs_t;

// Writes inverse and shifts; returns how far the padding moves all planes together.
INLINED float derive_shifts(slabs_t *slabs, const float3 origin, const float3 inverse, const padding_t *padding)
{
    const float3 slack = padding->distance * magnitude(inverse) + padding->time;
    const float3 shift = -origin * inverse;
    slabs->inverse = inverse;
    slabs->near_shift = shift - slack;
    slabs->far_shift = shift + slack;
    return slack.x + slack.y + slack.z;
}

// Derives inverse and shifts in the other unit.
INLINED void limit_shifts(slabs_t *slabs, const ray_t *ray)
{
    // A power of two: scaling by it is exact.
    const float unit = MIN_INVERSE / as_float(as_int(ray->shear.z) & 0x7f800000);
    const float3 largest = (float3)(absolute(ray->shear.z) * unit / MIN_SLOPE);
    const float3 inverse = ray->inverse * unit;
    const float3 limited = inverse < 0.0f ? -largest : largest;
    // An origin beyond float32 hits nothing, but the traversal has to end.
#if EXACT
    const float3 origin = magnitude(ray->origin) <= 0x1p64f ? ray->origin : (float3)(0x1p64f);
    const padding_t padding = pad_exactly(origin, ray->exact.blur);
#else
    const float3 origin = magnitude(ray->origin) <= FLT_MAX ? ray->origin : (float3)(FLT_MAX);
    const float3 reach = min(magnitude(origin) + LARGEST_COORDINATE, FLT_MAX);
    const float longest_reach = larger(reach.x, larger(reach.y, reach.z));
    const padding_t padding = find_padding(reach, longest_reach, absolute(ray->shear.z) * unit);
#endif
    derive_shifts(slabs, origin, magnitude(inverse) < largest ? inverse : limited, &padding);
    slabs->t_min = ray->t_min * unit;
    slabs->unit = unit;
}

INLINED slabs_t make_slabs(const ray_t *ray)
{
    const padding_t padding = find_ray_padding(ray);
    slabs_t slabs;
    slabs.t_min = ray->t_min;
    slabs.unit = 1.0f;
    if (!(derive_shifts(&slabs, ray->origin, ray->inverse, &padding) <= MAX_SLACK)) {
        limit_shifts(&slabs, ray);
    }
    // A node begins with six planes of WIDTH lanes each: the minima along x, y and z, then the maxima.
    const int3 is_backward = ray->inverse < 0.0f;
    const int3 axis = (int3)(0, 1, 2);
    slabs.near_offset = WIDTH * (axis + (is_backward & 3));
    slabs.far_offset = WIDTH * (axis + (~is_backward & 3));
    return slabs;
}

// The planes of WIDTH boxes, per axis the near ones and the far ones of a ray.
typedef struct {
    lanes_t near[3];
    lanes_t far[3];
} planes_t;

INLINED lanes_t cross_planes(const lanes_t planes, const float inverse, const float shift)
{
    return MULTIPLY_ADD_LANES(planes, (lanes_t)(inverse), (lanes_t)(shift));
}

// Returns one bit per box, set where the ray meets the padded box before `limit`, in units of the slabs. *t_near has
// the t at which the ray enters each box.
INLINED uint meets_planes(const planes_t *planes, const slabs_t *slabs, const float limit, lanes_t *t_near)
{
    const lanes_t near_x = cross_planes(planes->near[0], slabs->inverse.x, slabs->near_shift.x);
    const lanes_t near_y = cross_planes(planes->near[1], slabs->inverse.y, slabs->near_shift.y);
    const lanes_t near_z = cross_planes(planes->near[2], slabs->inverse.z, slabs->near_shift.z);
    const lanes_t far_x = cross_planes(planes->far[0], slabs->inverse.x, slabs->far_shift.x);
    const lanes_t far_y = cross_planes(planes->far[1], slabs->inverse.y, slabs->far_shift.y);
    const lanes_t far_z = cross_planes(planes->far[2], slabs->inverse.z, slabs->far_shift.z);
    // Compared in pairs: a tree of comparisons is shorter than a chain, and the choice of the next node waits for it.
    *t_near = larger_lanes(larger_lanes(near_x, near_y), larger_lanes(near_z, (lanes_t)(slabs->t_min)));
    const lanes_t t_far = smaller_lanes(smaller_lanes(far_x, far_y), smaller_lanes(far_z, (lanes_t)(limit)));
    return mask_bits(*t_near <= t_far * MEETING_GROWTH);
}

// As meets_planes, for the children of a node.
INLINED uint meets_children(
    const global node_t *node, const slabs_t *slabs, const float limit, lanes_t *t_near)
{
    const global float *planes = (const global float *)node;
    const planes_t loaded = {
        {load_lanes(planes + slabs->near_offset.x), load_lanes(planes + slabs->near_offset.y),
         load_lanes(planes + slabs->near_offset.z)},
        {load_lanes(planes + slabs->far_offset.x), load_lanes(planes + slabs->far_offset.y),
         load_lanes(planes + slabs->far_offset.z)}};
    return meets_planes(&loaded, slabs, limit, t_near);
}
