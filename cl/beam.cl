// Many rays as one: a beam, and which children of a node it meets (Heckbert and Hanrahan, "Beam tracing polygonal
// objects", 1984).
//
// At distance t, all rays of a beam are between least_origin + t * least_direction and most_origin + t * most_direction.
// So it meets a box no earlier than these two lines cross the box's planes. Both sides are rounded as in aabb.cl, and
// SLAB_SLACK covers that here as well: a box that any of the rays meets, the beam meets.

#include "aabb.cl"
#include "lanes.cl"

// The least and the greatest of each number of a beam's rays, in the order of ray_t: origin, t_min, direction, t_max.
typedef struct {
    float8 least;
    float8 most;
} ray_bounds_t;

INLINED ray_bounds_t no_rays(void)
{
    const ray_bounds_t bounds = {(float8)(INFINITY), (float8)(-INFINITY)};
    return bounds;
}

INLINED void include_ray(ray_bounds_t *bounds, const float8 ray)
{
    // Rays without an interval hit nothing, wherever they are.
    if (ray.s3 <= ray.s7) {
        bounds->least = ray < bounds->least ? ray : bounds->least;
        bounds->most = ray > bounds->most ? ray : bounds->most;
    }
}

// Slower than this along an axis, a beam is taken for one that does not move: 1 / x stays finite, and so does its
// product with a coordinate that a mesh may have.
#define LEAST_SPEED 0x1p-60f

// As `sides_t`: where the rows are of the planes that a beam comes to first and last, and what makes planes distances.
// Along an axis on which its rays go both ways, it comes to both planes and is never past one: the far plane is a second
// near one. Where a beam comes to it is limited to `most_early` and to `least_late`, so that it counts on one side only.
typedef struct {
    int3 near;
    int3 far;
    float3 near_origin;
    float3 far_origin;
    float3 near_inverse;
    float3 far_inverse;
    float3 most_early;
    float3 least_late;
    float t_min;
    float t_max;
    bool is_empty;     // without rays
    bool is_anything;  // its rays go everywhere, or are not all in float32
} beam_t;

INLINED beam_t make_beam(const ray_bounds_t *bounds)
{
    const float3 least_origin = bounds->least.s012;
    const float3 most_origin = bounds->most.s012;
    const float3 least = bounds->least.s456;
    const float3 most = bounds->most.s456;
    const int3 is_back = most < -LEAST_SPEED;
    const int3 is_both = !(is_back | (least > LEAST_SPEED));
    // A line that hardly moves, or moves away, does not come to a plane that is not behind it already: very late will do.
    const int3 is_most_slow = is_both & (most < LEAST_SPEED);
    const int3 is_least_slow = is_both & (least > -LEAST_SPEED);
    const float3 inverse_most = is_most_slow ? (float3)(1.0f / LEAST_SPEED) : 1.0f / most;
    const float3 inverse_least = is_least_slow ? (float3)(-1.0f / LEAST_SPEED) : 1.0f / least;

    beam_t beam;
    beam.near_origin = is_back ? least_origin : most_origin;
    beam.far_origin = is_back ? most_origin : least_origin;
    beam.near_inverse = is_back ? inverse_least : inverse_most;
    beam.far_inverse = is_back ? inverse_most : inverse_least;
    beam.most_early = is_both ? (float3)(INFINITY) : (float3)(-INFINITY);
    beam.least_late = is_both ? (float3)(FLT_MAX) : (float3)(-INFINITY);
    beam.t_min = bounds->least.s3;
    beam.t_max = bounds->most.s7;
    beam.is_empty = !(beam.t_min <= beam.t_max);
    const int3 is_far = !(magnitude(least_origin) < FLT_MAX & magnitude(most_origin) < FLT_MAX);
    beam.is_anything = (is_both.x & is_both.y & is_both.z) | is_far.x | is_far.y | is_far.z;
    const int3 axis = (int3)(0, 1, 2);
    beam.near = WIDTH * (axis + (is_back & 3));
    beam.far = WIDTH * (axis + (~is_back & 3));
    return beam;
}

INLINED lanes_t reach_planes(const global float *planes, const float origin, const float inverse)
{
    return (load_lanes(planes) - origin) * inverse;
}

// Returns a bit for each child that the beam may meet.
INLINED uint beam_meets_children(const global node_t *node, const beam_t *beam)
{
    const global float *rows = (const global float *)node;
    const lanes_t near_x = reach_planes(rows + beam->near.x, beam->near_origin.x, beam->near_inverse.x);
    const lanes_t near_y = reach_planes(rows + beam->near.y, beam->near_origin.y, beam->near_inverse.y);
    const lanes_t near_z = reach_planes(rows + beam->near.z, beam->near_origin.z, beam->near_inverse.z);
    const lanes_t far_x = reach_planes(rows + beam->far.x, beam->far_origin.x, beam->far_inverse.x);
    const lanes_t far_y = reach_planes(rows + beam->far.y, beam->far_origin.y, beam->far_inverse.y);
    const lanes_t far_z = reach_planes(rows + beam->far.z, beam->far_origin.z, beam->far_inverse.z);
    const lanes_t early_x = smaller_lanes(far_x, (lanes_t)(beam->most_early.x));
    const lanes_t early_y = smaller_lanes(far_y, (lanes_t)(beam->most_early.y));
    const lanes_t early_z = smaller_lanes(far_z, (lanes_t)(beam->most_early.z));
    const lanes_t late_x = larger_lanes(far_x, (lanes_t)(beam->least_late.x));
    const lanes_t late_y = larger_lanes(far_y, (lanes_t)(beam->least_late.y));
    const lanes_t late_z = larger_lanes(far_z, (lanes_t)(beam->least_late.z));
    const lanes_t enter = larger_lanes(
        larger_lanes(larger_lanes(near_x, near_y), larger_lanes(near_z, (lanes_t)(beam->t_min))),
        larger_lanes(larger_lanes(early_x, early_y), early_z));
    const lanes_t leave =
        smaller_lanes(smaller_lanes(late_x, late_y), smaller_lanes(late_z, (lanes_t)(beam->t_max)));
    return mask_bits(enter <= leave * SLAB_SLACK);
}
