// The slab test of a beam, a bundle of rays, against all children of a node (Heckbert and Hanrahan, "Beam tracing
// polygonal objects", 1984).
//
// At t, all rays of a beam lie between lower_origin + t * lower_direction and upper_origin + t * upper_direction, so
// none crosses a plane before the first of these two lines or after the second. The t of a plane is rounded as in
// boxes/aabb.cl. The origins are moved apart by the largest padding of the rays: a beam meets every box with a triangle
// that one of its rays may hit.

#include "boxes/padding.cl"
#include "math/lanes.cl"

// The bounds of all numbers of a beam's rays, in the order of packed_ray_t: origin, t_min, direction, t_max.
typedef struct {
    float8 lower;
    float8 upper;
} ray_bounds_t;

INLINED ray_bounds_t empty_bounds(void)
{
    const ray_bounds_t bounds = {(float8)(INFINITY), (float8)(-INFINITY)};
    return bounds;
}

INLINED void include_ray(ray_bounds_t *bounds, const float8 lanes)
{
    // A ray with an empty interval hits nothing and does not widen the beam.
    if (lanes.s3 <= lanes.s7) {
        bounds->lower = lanes < bounds->lower ? lanes : bounds->lower;
        bounds->upper = lanes > bounds->upper ? lanes : bounds->upper;
    }
}

// A smaller component of a direction counts as zero: its inverse stays finite, and so does the product with a
// coordinate of a mesh.
#define MIN_SPEED 0x1p-60f

// A beam as the slab test needs it, with plane offsets as in `slabs_t`. Along an axis on which its rays have both
// signs, a beam may enter through either plane and never leaves: the far plane is a second near plane. The t of the far
// plane counts as an entry up to far_entry_max and as an exit from far_exit_min on, one of which excludes it.
typedef struct {
    int3 near_offset;
    int3 far_offset;
    float3 near_origin;
    float3 far_origin;
    float3 near_inverse;
    float3 far_inverse;
    float3 far_entry_max;
    float3 far_exit_min;
    float t_min;
    float t_max;
    bool is_empty;      // no ray
    bool is_unbounded;  // the rays go everywhere, or an origin is beyond float32
} beam_t;

INLINED float largest_component(const float3 v)
{
    return larger(v.x, larger(v.y, v.z));
}

// The width of the padding for all rays of a beam, per axis. The longest component of each ray is at least as long as
// that of the slowest ray that the bounds allow; and no component is longer than the longest one.
INLINED float3 find_beam_padding(const ray_bounds_t *bounds)
{
    const float3 lower_origin = magnitude(bounds->lower.s012);
    const float3 upper_origin = magnitude(bounds->upper.s012);
    const float3 reach = (lower_origin > upper_origin ? lower_origin : upper_origin) + LARGEST_COORDINATE;
    const float longest_reach = largest_component(reach);
    const float3 lower_direction = bounds->lower.s456;
    const float3 upper_direction = bounds->upper.s456;
    const float3 fastest = -lower_direction > upper_direction ? -lower_direction : upper_direction;
    const float3 slowest = lower_direction > -upper_direction ? lower_direction : -upper_direction;
    const float inverse = 1.0f / larger(largest_component(slowest), MIN_SPEED);
    const padding_t padding = find_padding(reach, longest_reach, inverse);
    const float3 width = padding.time * fastest;
    const float3 most = (float3)(TIME_PADDING * longest_reach);
    return padding.distance + (width < most ? width : most);
}

INLINED beam_t make_beam(const ray_bounds_t *bounds)
{
    const float3 padding = find_beam_padding(bounds);
    const float3 lower_origin = bounds->lower.s012 - padding;
    const float3 upper_origin = bounds->upper.s012 + padding;
    const float3 lower_direction = bounds->lower.s456;
    const float3 upper_direction = bounds->upper.s456;
    const int3 is_backward = upper_direction < -MIN_SPEED;
    const int3 is_both_ways = !(is_backward | (lower_direction > MIN_SPEED));
    // A line that stands still or moves away reaches a plane ahead of it never: at a very large t.
    const int3 is_upper_slow = is_both_ways & (upper_direction < MIN_SPEED);
    const int3 is_lower_slow = is_both_ways & (lower_direction > -MIN_SPEED);
    const float3 inverse_upper = is_upper_slow ? (float3)(1.0f / MIN_SPEED) : 1.0f / upper_direction;
    const float3 inverse_lower = is_lower_slow ? (float3)(-1.0f / MIN_SPEED) : 1.0f / lower_direction;

    beam_t beam;
    beam.near_origin = is_backward ? lower_origin : upper_origin;
    beam.far_origin = is_backward ? upper_origin : lower_origin;
    beam.near_inverse = is_backward ? inverse_lower : inverse_upper;
    beam.far_inverse = is_backward ? inverse_upper : inverse_lower;
    beam.far_entry_max = is_both_ways ? (float3)(INFINITY) : (float3)(-INFINITY);
    beam.far_exit_min = is_both_ways ? (float3)(FLT_MAX) : (float3)(-INFINITY);
    beam.t_min = bounds->lower.s3;
    beam.t_max = bounds->upper.s7;
    beam.is_empty = !(beam.t_min <= beam.t_max);
    const int3 is_far = !(magnitude(lower_origin) < FLT_MAX & magnitude(upper_origin) < FLT_MAX);
    beam.is_unbounded = (is_both_ways.x & is_both_ways.y & is_both_ways.z) | is_far.x | is_far.y | is_far.z;
    const int3 axis = (int3)(0, 1, 2);
    beam.near_offset = WIDTH * (axis + (is_backward & 3));
    beam.far_offset = WIDTH * (axis + (~is_backward & 3));
    return beam;
}

// The t at which a line crosses each plane.
INLINED lanes_t reach_planes(const global float *planes, const float origin, const float inverse)
{
    return (load_lanes(planes) - origin) * inverse;
}

// Whether the beam may meet a box; *t_near is at most the t at which any of its rays enters that. The test of
// beam_meets_children, for a box by itself.
INLINED bool beam_meets_aabb(const float3 aabb_min, const float3 aabb_max, const beam_t *beam, float *t_near)
{
    const int3 is_backward = beam->near_offset >= 3 * WIDTH;
    const float3 near = ((is_backward ? aabb_max : aabb_min) - beam->near_origin) * beam->near_inverse;
    const float3 far = ((is_backward ? aabb_min : aabb_max) - beam->far_origin) * beam->far_inverse;
    const float3 far_entry = far < beam->far_entry_max ? far : beam->far_entry_max;
    const float3 far_exit = far > beam->far_exit_min ? far : beam->far_exit_min;
    *t_near = larger(larger(largest_component(near), beam->t_min), largest_component(far_entry));
    return *t_near <= smaller(smaller(far_exit.x, far_exit.y), smaller(far_exit.z, beam->t_max));
}

// Returns one bit per child, set where the beam may meet the child's box.
INLINED uint beam_meets_children(const global node_t *node, const beam_t *beam)
{
    const global float *planes = (const global float *)node;
    const lanes_t near_x = reach_planes(planes + beam->near_offset.x, beam->near_origin.x, beam->near_inverse.x);
    const lanes_t near_y = reach_planes(planes + beam->near_offset.y, beam->near_origin.y, beam->near_inverse.y);
    const lanes_t near_z = reach_planes(planes + beam->near_offset.z, beam->near_origin.z, beam->near_inverse.z);
    const lanes_t far_x = reach_planes(planes + beam->far_offset.x, beam->far_origin.x, beam->far_inverse.x);
    const lanes_t far_y = reach_planes(planes + beam->far_offset.y, beam->far_origin.y, beam->far_inverse.y);
    const lanes_t far_z = reach_planes(planes + beam->far_offset.z, beam->far_origin.z, beam->far_inverse.z);
    const lanes_t far_entry_x = smaller_lanes(far_x, (lanes_t)(beam->far_entry_max.x));
    const lanes_t far_entry_y = smaller_lanes(far_y, (lanes_t)(beam->far_entry_max.y));
    const lanes_t far_entry_z = smaller_lanes(far_z, (lanes_t)(beam->far_entry_max.z));
    const lanes_t far_exit_x = larger_lanes(far_x, (lanes_t)(beam->far_exit_min.x));
    const lanes_t far_exit_y = larger_lanes(far_y, (lanes_t)(beam->far_exit_min.y));
    const lanes_t far_exit_z = larger_lanes(far_z, (lanes_t)(beam->far_exit_min.z));
    const lanes_t enter = larger_lanes(
        larger_lanes(larger_lanes(near_x, near_y), larger_lanes(near_z, (lanes_t)(beam->t_min))),
        larger_lanes(larger_lanes(far_entry_x, far_entry_y), far_entry_z));
    const lanes_t leave =
        smaller_lanes(smaller_lanes(far_exit_x, far_exit_y), smaller_lanes(far_exit_z, (lanes_t)(beam->t_max)));
    return mask_bits(enter <= leave);
}
