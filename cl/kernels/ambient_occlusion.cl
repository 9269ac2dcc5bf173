// Of rays that are drawn over a surface at each point, how many meet nothing.
//
// Shared arguments: see cl/world/world.cl.
// points[point_count]         hemisphere_t: the world's local coordinates. Neighbours should be close together in space
// first_ray, ray_count        the samples that are drawn at each point
// seed                        of the samples
// open_counts[point_count]    written: from 0 to ray_count
//
// Work-items: (point_count), rounded up to whole work-groups.

// keep: includes files that others include in branches
#include "world/world.cl"

#include "occlusion/hemisphere.cl"
#include "occlusion/subtrees.cl"
#if !LONE
#include "instances/lift.cl"
#endif

// The origin of a point's rays. The host has lifted points over a lone shape.
INLINED position_t find_origin(const world_t *world, const global hemisphere_t *point)
{
    position_t origin = {load3(point->position), load3(point->position_low)};
#if !LONE
    const float3 normal = load3(point->normal);
    const point_pair_t below = {origin.high, origin.low, point->mask};
    float3 low;
    origin.high = add_exactly(origin.high, lift_over_instances(world, &below, normal) * normal, &low);
    origin.low += low;
#endif
    return origin;
}

kernel void ambient_occlusion(
    WORLD_ARGUMENTS, const global hemisphere_t *restrict points, const int point_count,
    global int *restrict open_counts, const int first_ray, const int ray_count, const uint seed)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const world_t world = WORLD(root_of(nodes));
    const global hemisphere_t *point = points + index;
    const position_t origin = find_origin(&world, point);
    subtrees_t subtrees;
    find_subtrees(&world, origin.high, load3(point->normal), point->t_max, &subtrees);

    int open_count = 0;
    for (int begin = 0; begin < ray_count; begin += DRAWN_AT_ONCE) {
        const int count = min(DRAWN_AT_ONCE, ray_count - begin);
        directions_t directions;
        draw_directions(point, seed, first_ray + begin, count, &directions);
        for (int i = 0; i < count; i++) {
            world_ray_t ray =
                make_world_ray(origin, direction_of(&directions, i), (float3)(0.0f), point->t_max);
#if !LONE
            ray.mask = point->mask;
#endif
            open_count += !meets_subtrees(&world, &subtrees, &ray);
        }
    }
    open_counts[index] = open_count;
}
