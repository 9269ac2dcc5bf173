// Shadows: whether the directed light reaches a surface.

#include "world/surface.cl"

// Whether nothing lies between a surface and the light. Without shadows, nothing does.
INLINED bool sees_light(const global view_t *view, const world_t *world, const world_surface_t *surface)
{
    if (view->shading != SHADE_LAMBERT_SHADOW) {
        return true;
    }
    const float3 to_light = load3(view->to_light);
    return dot_product(surface->normal, to_light) > 0.0f && !is_blocked(world, surface->above, to_light, INFINITY);
}
