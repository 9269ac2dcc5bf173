// The padding of boxes: how far the slab tests move all planes outwards, derived once per ray.
//
// Every box around a triangle is met whenever the triangle test computes a t within the limits. The slab test compares
// the distances of planes with limits, one of which may be the t of a triangle, and all of these are rounded. The error
// of a triangle's t is relative to the coordinates of its corners, not to t, so no factor of t bounds it.
// docs/internals/padding.md has the proof: 13 roundings relative to the coordinates along an axis, and 27 relative to
// those along the direction's longest component, as far as the ray moves along the axis meanwhile.
//
// Assumes t >= 0, coordinates of the mesh from -1 to 1, as the host scales them, and directions of moderate length.

#include "rays/ray.cl"

// One rounding more than the proof needs stands for those of the padding itself.
#define AXIS_PADDING ERROR_BOUND(13 + 1)
#define TIME_PADDING ERROR_BOUND(27 + 1)

// A component of the direction below this share of the longest one may count as any number up to that, or underflow.
// The ray moves aside by at most this share of its way meanwhile; the padding has room for twice that.
#if EXACT
#define MIN_SLOPE 0x1p-60f
#else
#define MIN_SLOPE 0x1p-30f
#endif

// The largest absolute coordinate of a mesh. That of the root would do as well, and pad less along an axis on which the
// mesh is thin; but to find it for each ray takes 6 % of the time of coherent rays.
#define LARGEST_COORDINATE 1.0f

// The padding along an axis is distance + time * the direction's component.
typedef struct {
    float3 distance;
    float time;  // units of t
} padding_t;

// Returns the padding for all rays within bounds.
//
// reach           per axis: the largest absolute coordinates of the mesh and of the origin, together
// longest_reach   the reach along the axis of the direction's longest component
// inverse         the absolute inverse of that component
INLINED padding_t find_padding(const float3 reach, const float longest_reach, const float inverse)
{
    const padding_t padding = {
        AXIS_PADDING * reach + 2.0f * MIN_SLOPE * longest_reach, TIME_PADDING * longest_reach * inverse};
    return padding;
}

#if EXACT

// The exact test finds the crossings of the file's triangles with the user's ray; a box is around corners that are
// rounded to float32. So the planes need room for the rounding of corners, origin and direction, and for that of the
// slab test. Some are relative to the origin's coordinate along the axis, and move the planes; the others are relative
// to the distance of a plane from the origin, which is its t, see MEETING_GROWTH. A small shape keeps a small padding.
INLINED padding_t pad_exactly(const float3 origin, const float blur)
{
    const padding_t padding = {ERROR_BOUND(16) * magnitude(origin) + blur, 0.0f};
    return padding;
}

INLINED padding_t find_ray_padding(const ray_t *ray)
{
    return pad_exactly(ray->origin, ray->exact.blur);
}

#else

INLINED padding_t find_ray_padding(const ray_t *ray)
{
    const float3 reach = magnitude(ray->origin) + LARGEST_COORDINATE;
    const float longest_reach = permute_axes(reach, ray->axis).z;
    // That of the longest component, without waiting for the axis.
    const float3 inverse = magnitude(ray->inverse);
    return find_padding(reach, longest_reach, smaller(smaller(inverse.x, inverse.y), inverse.z));
}

#endif

// The t at which a ray leaves a box is multiplied by it.
#if EXACT
#define MEETING_GROWTH (1.0f + ERROR_BOUND(32))
#else
#define MEETING_GROWTH 1.0f
#endif
