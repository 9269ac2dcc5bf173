// Of rays that are drawn over a surface in a scene at each point, how many meet nothing.
//
// Shared arguments: see cl/instances/traverse.cl and cl/kernels/ambient_occlusion.cl.
// points[point_count]     hemisphere_t: local coordinates of the scene
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "instances/lift.cl"
#include "occlusion/hemisphere.cl"
#include "world/world.cl"

kernel void scene_ambient_occlusion(
    WORLD_ARGUMENTS, const global hemisphere_t *restrict points, global int *restrict open_counts, const int point_count, const int first_ray, const int ray_count, const uint seed)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const global hemisphere_t *point = points + index;
    const float3 normal = load3(point->normal);
    const point_pair_t below = {load3(point->position), load3(point->position_low), point->mask};
    float3 low;
    const float3 position =
        add_exactly(below.position, lift_over_instances(top_nodes, instances, &below, normal) * normal, &low);

    int open_count = 0;
    for (int begin = 0; begin < ray_count; begin += DRAWN_AT_ONCE) {
        const int count = min(DRAWN_AT_ONCE, ray_count - begin);
        directions_t directions;
        draw_directions(point, seed, first_ray + begin, count, &directions);
        for (int i = 0; i < count; i++) {
            const ray_pair_t ray = {
                position, direction_of(&directions, i), 0.0f, point->t_max, below.position_low + low, (float3)(0.0f),
                point->mask};
            search_t search = make_search(1, 0);
            traverse_instances(
                top_nodes, instances, nodes, blocks, spheres, start_at_root(), &ray, &search, QUERY_COUNT);
            open_count += search.count == 0;
        }
    }
    open_counts[index] = open_count;
}
