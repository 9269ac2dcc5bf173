// The surface that a ray has met, in the local coordinates of its shape.

#include "shading/surface.cl"
#include "spheres/surface.cl"
#include "world/world.cl"

// The ray as the shape has it, and its direction alone; a lone shape has no instance.
INLINED ray_t ray_in_shape(const world_ray_t *ray, const global instance_t *instance)
{
#if !LONE
    float t_shift;
    return enter_instance(ray, instance, INFINITY, &t_shift);
#elif EXACT
    return rounded_ray(ray);
#else
    return *ray;
#endif
}

INLINED float3 direction_in_shape(const world_ray_t *ray, const global instance_t *instance)
{
#if LONE
    return ray->direction;
#else
    return transform_vector(instance->to_object, ray->direction);
#endif
}

// *sphere_radius is 0 for primitives that are no sphere.
INLINED surface_t prim_surface_at(
    const world_t *world, const global instance_t *instance, const int instance_id, const world_ray_t *ray,
    const crossing_t *crossing, float *sphere_radius)
{
#if LONE
    const int kind = ONLY_KIND;
    const global block_t *blocks = world->blocks.own;
#else
    const int kind = instance->kind;
    const global block_t *blocks = find_blocks(instance, world->blocks);
#endif
    *sphere_radius = 0.0f;
    if (IS_SPHERES(kind)) {
        const ray_t inside = ray_in_shape(ray, instance);
        const ball_t ball = ball_at((const global sphere_block_t *)blocks, crossing->triangle_index);
        *sphere_radius = ball.radius;
        return sphere_surface_at(&ball, crossing->u > 0.0f, &inside);
    }
    const corners_t corners = corners_at(blocks, crossing->triangle_index);
#if EXACT
    const corners_t edges = exact_edges(&world->shapes, instance_id, crossing->prim_id);
#else
    const corners_t edges = corners;
#endif
    const surface_t tight = surface_at(&corners, &edges, crossing, direction_in_shape(ray, instance));
    return with_even_error(&tight);
}
