// How deep each point is inside a world: of the instances that contain it, the one whose surface is the farthest, and
// the primitive of it that is nearest to the point.
//
// Shared arguments: see cl/world/world.cl, cl/world/points.cl and cl/world/inside.cl.
// metrics[]              see cl/world/nearest.cl
// prims[point_count]     written: NO_PRIM for points that no instance contains
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "world/inside.cl"

kernel void depth(WORLD_ARGUMENTS, POINT_ARGUMENTS, SURPLUS_ARGUMENTS,
    const global metric_record_t *restrict metrics, global world_prim_t *restrict prims)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const world_t world = WORLD(root_of(nodes));
    const point_pair_t point = unpack_point(points + index);
    const surplus_t uncounted = {surplus, first_surplus};
    prims[index] = find_deepest(&world, &uncounted, metrics, &point);
}
