// Whether a closed shape, or any closed instance, contains each point. Nothing contains points out of the box.
//
// Shared arguments: see cl/world/world.cl, cl/world/points.cl and cl/world/inside.cl.
// is_inside[point_count]  uchar, written: 1 or 0

#include "world/inside.cl"

kernel void inside(WORLD_ARGUMENTS, POINT_ARGUMENTS, SURPLUS_ARGUMENTS, global uchar *restrict is_inside)
{
    OPEN_POINT;
    const world_t world = WORLD(root_of(nodes));
    const surplus_t uncounted = {surplus, first_surplus};
    is_inside[point_id] = IS_IN_BOX && is_in_world(&world, &uncounted, &point);
}
