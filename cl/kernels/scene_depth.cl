// How deep each point is inside a scene: of the instances that contain it, the one whose surface is the farthest, and
// the primitive of it that is nearest to the point.
//
// Shared arguments: see cl/instances/traverse.cl.
// points[point_count]     scene_point_t: local coordinates of the scene
// prims[point_count]      scene_prim_t, written: NO_PRIM for points that no instance contains
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "instances/around.cl"

kernel void scene_depth(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global block_t *restrict blocks, const global float *restrict spheres,
    const global scene_point_t *restrict points, global scene_prim_t *restrict prims, const int point_count)
{
    const int index = get_global_id(0);
    if (index >= point_count) {
        return;
    }
    const scene_point_pair_t point = unpack_scene_point(points + index);
    scene_nearest_t none = no_scene_nearest();
    is_in_scene(top_nodes, instances, nodes, blocks, spheres, &point, &none.prim);
    prims[index] = none.prim;
}
