// The nearest primitive of each point; of equally near ones that of the smallest instance_id, and then the smallest
// prim_id.
//
// Shared arguments: see cl/world/world.cl and cl/world/points.cl.
// metrics[]              see cl/world/nearest.cl
// prims[point_count]     written: NO_PRIM where no proper primitive is visible

#include "world/nearest.cl"

kernel void closest_point(WORLD_ARGUMENTS, POINT_ARGUMENTS,
    const global metric_record_t *restrict metrics, PRIM_ARGUMENTS)
{
    OPEN_POINT;
    const world_t world = WORLD(root_of(nodes));
    WRITE_PRIM(find_world_nearest(&world, metrics, &point, no_heap()).prim);
}
