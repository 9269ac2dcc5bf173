// Whether any closed instance of a scene contains each point.
//
// Shared arguments: see cl/instances/traverse.cl.
// points[point_count]     scene_point_t: local coordinates of the scene
// inside[point_count]     uchar, written: 1 or 0
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "instances/around.cl"
#include "world/world.cl"

kernel void scene_inside(
    WORLD_ARGUMENTS, const global scene_point_t *restrict points, global uchar *restrict inside, const int point_count)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const point_pair_t point = unpack_scene_point(points + index);
    inside[index] = is_in_scene(top_nodes, instances, 0, nodes, blocks, spheres, &point, 0);
}
