// How deep each point is inside a world: of the instances that contain it, the one whose surface is the farthest, and
// the primitive of it that is nearest to the point.
//
// Shared arguments: see cl/world/world.cl, cl/world/points.cl and cl/world/inside.cl.
// metrics[]              see cl/world/nearest.cl
// prims[point_count]     written: NO_PRIM for points that no instance contains

#include "world/inside.cl"

kernel void depth(WORLD_ARGUMENTS, POINT_ARGUMENTS, SURPLUS_ARGUMENTS,
    const global metric_record_t *restrict metrics, PRIM_ARGUMENTS)
{
    OPEN_POINT;
    const world_t world = WORLD(root_of(nodes));
    const surplus_t uncounted = {surplus, first_surplus};
    WRITE_PRIM(find_deepest(&world, &uncounted, metrics, &point));
}
