// A point as devices look it up: in the world's local coordinates, as a pair of float32, its mask, and how far away a
// primitive may be.

#include "structs.cl"
#include "math/pairs.cl"

typedef struct {
    float3 position;
    float3 position_low;
    uint mask;
    float limit;
    // The middle of an upright box, and half its sides; 0 of a point.
    bool is_box;
    float3 half_sides;
} point_pair_t;

#if !LONE
INLINED bool is_visible(const point_pair_t *point, const global instance_t *instance)
{
    return (point->mask & instance->mask) != 0;
}

// The way from a point to the zero of an instance's local coordinates.
INLINED float3 way_to_instance(const global instance_t *instance, const point_pair_t *point)
{
    float3 low;
    const float3 way = add_exactly(load3(instance->centre), -point->position, &low);
    return way + (low + (load3(instance->centre_low) - point->position_low));
}
#endif
