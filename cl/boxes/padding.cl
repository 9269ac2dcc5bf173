// The padding of boxes: how far the slab tests move all planes outwards, derived once per ray.
//
// Every box around a triangle is met whenever the triangle test computes a t within the limits. The slab test compares
// the distances of planes with limits, one of which may be the t of a triangle, and all of these are rounded. The error
// of a triangle's t is relative to the coordinates of its corners, not to t, so no factor of t bounds it.
// docs/internals/tracing.md has the proof, which needs 13 roundings relative to the coordinates along an axis, and
// 27 relative to those along the direction's longest component, as far as the ray moves along the axis meanwhile.
//
// Assumes t >= 0, and that no product underflows: a mesh of size 1 has no triangle with an area below 2^-96.

#include "rays/ray.cl"

// One rounding more than the proof needs stands for those of the padding itself.
#define AXIS_PADDING ERROR_BOUND(13 + 1)
#define TIME_PADDING ERROR_BOUND(27 + 1)

// Slopes that are smaller than this, relative to the longest component, may be rounded to zero or to this by any test.
// A ray moves across the mesh by as much of the mesh's size meanwhile; the padding has room for twice that.
#define MIN_SLOPE 0x1p-30f

// More than is lost by underflow in a test.
#define UNDERFLOW_PADDING 0x1p-86f

// The padding along an axis is distance + time * the direction's component.
typedef struct {
    float3 distance;
    float time;  // units of t
} padding_t;

// Returns the padding of boxes for all rays in a range.
//
// reach           per axis: the largest absolute coordinates of the boxes and of the origin, together
// longest_reach   the reach along the axis of the direction's longest component
// inverse         the absolute inverse of that component
INLINED padding_t find_padding(const float3 reach, const float longest_reach, const float inverse)
{
    const padding_t padding = {
        AXIS_PADDING * reach + (2.0f * MIN_SLOPE * longest_reach + UNDERFLOW_PADDING),
        TIME_PADDING * longest_reach * inverse};
    return padding;
}

INLINED padding_t find_ray_padding(const ray_t *ray, const float3 largest_coordinates)
{
    const float3 reach = magnitude(ray->origin) + largest_coordinates;
    const float longest_reach = ray->axis == 0 ? reach.x : ray->axis == 1 ? reach.y : reach.z;
    return find_padding(reach, longest_reach, fabs(ray->shear.z));
}
