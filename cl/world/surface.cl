// The surface that a ray of a picture has met, in the world's local coordinates.

// keep: files that both branches need are expanded before them
#include "prims/surface.cl"
#include "shading/surface.cl"
#include "world/world.cl"
#if !LONE
#include "instances/surface.cl"
#endif

// How far a point of a triangle lies below the smooth surface for which its normals stand: the tangent planes at the
// corners, where they are above it. Rays that begin there are not stopped by the facets of a round surface (Hanika,
// "Hacking the shadow terminator", Ray Tracing Gems II, 2021).
INLINED float3 find_lift(const corners_t *corners, const crossing_t *crossing, const float3 normals[3])
{
    const float shares[3] = {1.0f - crossing->u - crossing->v, crossing->u, crossing->v};
    const float3 at[3] = {corners->a, corners->b, corners->c};
    const float3 position = shares[0] * at[0] + shares[1] * at[1] + shares[2] * at[2];
    float3 lift = (float3)(0.0f);
    for (int corner = 0; corner < 3; corner++) {
        const float depth = larger(dot_product(at[corner] - position, normals[corner]), 0.0f);
        lift += shares[corner] * depth * normals[corner];
    }
    return lift;
}

// The surface that a ray has met, in the world's local coordinates.
typedef struct {
    float3 position;
    position_t above;  // just above the surface, on the ray's side of it
    position_t below;  // just below it
    float3 normal;     // geometric unit vector on the side of the ray's origin
    bool is_back;      // whether the ray comes from the side from which the corners of a triangle are clockwise
    int instance_id;   // 0 of a lone shape
    int prim_id;
    float u;
    float v;
    float sphere_radius;  // 0 for a primitive that is no sphere
} world_surface_t;

#if LONE

// The kind of the primitive that was hit.
INLINED int hit_kind(const world_t *world, const search_t *search)
{
    return ONLY_KIND;
}

CALLED world_surface_t world_surface_at(const world_t *world, const world_ray_t *ray, const search_t *search)
{
    float radius;
    const surface_t own = prim_surface_at(world, 0, 0, ray, &search->nearest, &radius);
    const world_surface_t surface = {
        own.position, {point_above(&own), (float3)(0.0f)}, {point_below(&own), (float3)(0.0f)}, own.normal,
        own.is_back, 0, search->nearest.prim_id, search->nearest.u, search->nearest.v, radius};
    return surface;
}

// A normal or a vector of the shape that was hit, in the world's local coordinates; normals are not of length 1.
INLINED float3 place_normal(const world_t *world, const search_t *search, const float3 normal)
{
    return normal;
}

INLINED float3 place_unit_normal(const world_t *world, const search_t *search, const float3 normal)
{
    return normal;
}

INLINED float3 place_vector(const world_t *world, const search_t *search, const float3 vector)
{
    return vector;
}

// The corners of the triangle that was hit, in its shape's local coordinates.
INLINED corners_t hit_corners(const world_t *world, const search_t *search)
{
    return corners_at(world->blocks.own, search->nearest.triangle_index);
}

#else

INLINED int hit_kind(const world_t *world, const search_t *search)
{
    return world->instances[search->instance_index].kind;
}

CALLED world_surface_t world_surface_at(const world_t *world, const world_ray_t *ray, const search_t *search)
{
    const global instance_t *instance = world->instances + search->instance_index;
    float radius;
    const surface_t own = prim_surface_at(world, instance, search->instance_id, ray, &search->nearest, &radius);
    const instance_surface_t placed = place_surface(instance, &own);
    if (radius > 0.0f) {
        // Of a sphere that its instance does not stretch.
        const float3 scale = load3(instance->to_world[0]);
        radius *= square_root(dot_product(scale, scale));
    }
    const world_surface_t surface = {
        placed.above, {placed.above, placed.above_low}, {placed.below, placed.below_low}, placed.normal,
        placed.is_back, search->instance_id, search->nearest.prim_id, search->nearest.u, search->nearest.v, radius};
    return surface;
}

// Normals are transformed by the transpose of the inverse.
INLINED float3 place_normal(const world_t *world, const search_t *search, const float3 normal)
{
    const global instance_t *instance = world->instances + search->instance_index;
    return normal.x * load3(instance->to_object[0]) + normal.y * load3(instance->to_object[1])
        + normal.z * load3(instance->to_object[2]);
}

INLINED float3 place_unit_normal(const world_t *world, const search_t *search, const float3 normal)
{
    return unit_vector(place_normal(world, search, normal));
}

INLINED float3 place_vector(const world_t *world, const search_t *search, const float3 vector)
{
    return transform_vector(world->instances[search->instance_index].to_world, vector);
}

INLINED corners_t hit_corners(const world_t *world, const search_t *search)
{
    const global instance_t *instance = world->instances + search->instance_index;
    return corners_at(find_blocks(instance, world->blocks), search->nearest.triangle_index);
}

#endif

// The edges from the first corner of the triangle that was hit to the others, in the world's local coordinates.
INLINED void world_edges(const world_t *world, const search_t *search, float3 *ab, float3 *ac)
{
    const corners_t corners = hit_corners(world, search);
    *ab = place_vector(world, search, corners.b - corners.a);
    *ac = place_vector(world, search, corners.c - corners.a);
}

// The lift of the point that was hit, for unit normals at the corners of its triangle, in the shape's coordinates.
INLINED float3 world_lift(const world_t *world, const search_t *search, const float3 normals[3])
{
    const corners_t corners = hit_corners(world, search);
    return place_vector(world, search, find_lift(&corners, &search->nearest, normals));
}
