// Whether a closed shape, or any closed instance, contains each point.
//
// Shared arguments: see cl/world/world.cl, cl/world/points.cl and cl/world/inside.cl.
// is_inside[point_count]  uchar, written: 1 or 0
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "world/inside.cl"

kernel void inside(WORLD_ARGUMENTS, POINT_ARGUMENTS, SURPLUS_ARGUMENTS, global uchar *restrict is_inside)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const world_t world = WORLD(root_of(nodes));
    const point_pair_t point = unpack_point(points + index);
    const surplus_t uncounted = {surplus, first_surplus};
    is_inside[index] = is_in_world(&world, &uncounted, &point);
}
