// How deep each point is inside a scene: of the instances that contain it, the one whose surface is the farthest, and
// the primitive of it that is nearest to the point.
//
// Shared arguments: see cl/instances/traverse.cl.
// metrics[]               metric_record_t: of the instances, by their ids
// points[point_count]     scene_point_t: local coordinates of the scene
// prims[point_count]      world_prim_t, written: NO_PRIM for points that no instance contains
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "instances/around.cl"
#include "world/world.cl"

kernel void scene_depth(
    WORLD_ARGUMENTS, const global metric_record_t *restrict metrics, const global scene_point_t *restrict points,
    global world_prim_t *restrict prims, const int point_count)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const point_pair_t point = unpack_scene_point(points + index);
    scene_nearest_t none = no_scene_nearest();
    is_in_scene(top_nodes, instances, metrics, nodes, blocks, spheres, &point, &none.prim);
    prims[index] = none.prim;
}
