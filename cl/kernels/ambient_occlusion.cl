// Of rays that are drawn over a surface at each point, how many meet nothing.
//
// nodes[node_count]           node_t: the tree in its layout, see clbvh/structs.py
// blocks[block_count]         block_t: triangles in leaf order, local coordinates
// points[point_count]         hemisphere_t: local coordinates. Neighbours should be close together in space
// first_ray, ray_count        the samples that are drawn at each point
// seed                        of the samples
// open_counts[point_count]    written: from 0 to ray_count
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "occlusion/hemisphere.cl"
#include "occlusion/subtrees.cl"
#include "world/world.cl"

kernel void ambient_occlusion(
    WORLD_ARGUMENTS, const global hemisphere_t *restrict points, global int *restrict open_counts, const int point_count, const int first_ray, const int ray_count, const uint seed)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const global hemisphere_t *point = points + index;
    const float3 position = load3(point->position);
    subtrees_t subtrees;
    find_subtrees(nodes, position, load3(point->normal), point->t_max, &subtrees);

    int open_count = 0;
    for (int begin = 0; begin < ray_count; begin += DRAWN_AT_ONCE) {
        const int count = min(DRAWN_AT_ONCE, ray_count - begin);
        directions_t directions;
        draw_directions(point, seed, first_ray + begin, count, &directions);
        for (int i = 0; i < count; i++) {
            const ray_t ray = make_ray(position, direction_of(&directions, i), 0.0f, point->t_max);
            open_count += !meets_subtrees(&subtrees, nodes, blocks, block_count, &ray);
        }
    }
    open_counts[index] = open_count;
}
