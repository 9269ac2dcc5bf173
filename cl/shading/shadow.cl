// Shadows: whether the directed light reaches a surface.

#include "shading/surface.cl"
#include "traversal/traverse.cl"

// Whether nothing lies between a surface and the light. Without shadows, nothing does.
INLINED bool sees_light(
    const global view_t *view, const surface_t *surface, const global node_t *nodes,
    const global block_t *blocks, const int block_count)
{
    if (view->shading != SHADE_LAMBERT_SHADOW) {
        return true;
    }
    const float3 to_light = load3(view->to_light);
    if (!(dot_product(surface->normal, to_light) > 0.0f)) {
        return false;
    }
    const ray_t ray = make_ray(point_above(surface), to_light, 0.0f, INFINITY);
    search_t blockers = make_search(1, 0);
    traverse(nodes, nodes, blocks, block_count, &ray, &blockers, QUERY_COUNT);
    return blockers.count == 0;
}
