// The nearest primitive of each point in a scene; of equally near ones that of the smallest instance_id, and then the
// smallest prim_id.
//
// Shared arguments: see cl/instances/traverse.cl.
// metrics[]               metric_record_t: of the instances, by their ids
// points[point_count]     scene_point_t: local coordinates of the scene
// prims[point_count]      world_prim_t, written: NO_PRIM where no instance with a proper primitive is visible
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "instances/nearest.cl"
#include "world/world.cl"

kernel void scene_closest_point(
    WORLD_ARGUMENTS, const global metric_record_t *restrict metrics, const global scene_point_t *restrict points,
    global world_prim_t *restrict prims, const int point_count)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const point_pair_t point = unpack_scene_point(points + index);
    prims[index] = find_nearest_in_scene(top_nodes, instances, metrics, nodes, blocks, spheres, &point);
}
