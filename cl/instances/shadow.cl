// Shadows in a scene: whether the directed light reaches a surface.

#include "instances/camera.cl"
#include "instances/start.cl"
#include "instances/surface.cl"

// Whether nothing lies between a surface and the light. Without shadows, nothing does.
INLINED bool sees_light_in_scene(
    const global view_t *view, const placed_surface_t *surface, const global bvh2_node_t *top_nodes,
    const global instance_t *instances, const global node_t *nodes, const global block_t *blocks,
    const global float *spheres)
{
    if (view->shading != SHADE_LAMBERT_SHADOW) {
        return true;
    }
    const float3 to_light = load3(view->to_light);
    if (!(dot_product(surface->normal, to_light) > 0.0f)) {
        return false;
    }
    const scene_ray_pair_t ray = {
        surface->above, to_light, 0.0f, INFINITY, surface->above_low, (float3)(0.0f), PICTURE_MASK};
    search_t blockers = make_search(1, 0);
    const scene_start_t root = start_at_root();
    traverse_scene(top_nodes, instances, nodes, blocks, spheres, root, &ray, &blockers, QUERY_COUNT);
    return blockers.count == 0;
}
