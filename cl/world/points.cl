// Points in memory that are looked up in a world.
//
// points[point_count]    packed_point_t: the world's local coordinates; a lone shape is in float32, and has no mask
//
// What kernels write, where it is not their own:
//
// prims[point_count]           world_prim_t
// hits[point_count * slots]    kept_hit_t
// slots                        results per point, at least 1
// is_single                    whether only the nearest one of them is wanted
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "points/point.cl"
#include "world/world.cl"

#define POINT_ARGUMENTS const global packed_point_t *restrict points, const int point_count
#define PRIM_ARGUMENTS global world_prim_t *restrict prims
#define SLOT_ARGUMENTS global kept_hit_t *restrict hits, const int slots, const int is_single

INLINED point_pair_t unpack_point(const global packed_point_t *packed)
{
    const point_pair_t point = {
        load3(packed->position), load3(packed->position_low), packed->mask, packed->limit,
        false, (float3)(0.0f)};
    return point;
}

// Declares the `point` of a work-item, the `point_id` by which its results are written, and the `place` of its slots.
#define OPEN_POINT \
    const int place = get_global_id(0), point_id = place; \
    if (place >= point_count) { \
        return; \
    } \
    const point_pair_t point = unpack_point(points + point_id)

#define WRITE_PRIM(prim) prims[point_id] = (prim)

// Points out of the box are not looked up here.
#define IS_IN_BOX true

// The host chooses among the primitives in the slots.
#define CHOOSE_PRIMS()
