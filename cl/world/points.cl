// Points in memory that are looked up in a world.
//
// points[point_count]    packed_point_t: the world's local coordinates; a lone shape is in float32, and has no mask

#include "world/world.cl"

#define POINT_ARGUMENTS const global packed_point_t *restrict points, const int point_count

typedef struct {
    float3 position;
    float3 position_low;
    uint mask;
} point_pair_t;

INLINED point_pair_t unpack_point(const global packed_point_t *packed)
{
    const point_pair_t point = {load3(packed->position), load3(packed->position_low), packed->mask};
    return point;
}

// The primitives of a lone shape.
#if LONE
#define LONE_KIND (HAS_SPHERES ? KIND_SPHERES : KIND_TRIANGLES)
#endif
