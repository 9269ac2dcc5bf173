// The nearest triangle of each point in a lone mesh, with its distance: of several meshes that are parts of one, in its
// local coordinates, the least pair of distance and number is the answer of kernels/closest_point.cl for the whole.
//
// Shared arguments: see cl/world/world.cl and cl/world/points.cl.
// hits[point_count]    written: t is the squared distance, prim_id is NO_PRIM where there is no proper triangle
//
// Assumes LONE as 1.

#include "world/nearest.cl"

kernel void closest_in_shard(WORLD_ARGUMENTS, POINT_ARGUMENTS, global hit_t *restrict hits)
{
    OPEN_POINT;
#if LONE
    const world_t world = WORLD(root_of(nodes));
    nearest_t nearest = make_nearest(make_lone_metric(point.position, (float3)(0.0f)), ONLY_KIND);
    find_nearest(world.nodes, world.blocks.own, world.block_count, &nearest);
    const hit_t hit = {nearest.distance_squared, 0.0f, 0.0f, nearest.prim_id};
    hits[point_id] = hit;
#endif
}
