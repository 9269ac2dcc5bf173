// What the rays of a picture are cast at: the tree of one mesh, or a scene of instances (HAS_INSTANCES), behind one
// interface.
//
// Kernels take the arguments of both, and those of the other kind are NULL or 0:
//
// nodes[], blocks[], block_count         the tree, see rays/batch.cl; in a scene see instances/traverse.cl
// top_nodes[], instances[], spheres[]    the rest of a scene, see instances/traverse.cl
// entry_points[], tiles[]                where the rays of each tile begin, see traversal/entry_point.cl, and in a
//                                        scene instances/start.cl. NULL: all rays begin at the root

// keep: files that both branches need are expanded before them
#include "boxes/aabb.cl"
#include "math/pairs.cl"
#include "rays/batch.cl"
#include "shading/surface.cl"
#include "traversal/entry_point.cl"
#if HAS_INSTANCES
#include "instances/start.cl"
#include "instances/surface.cl"
#include "instances/traverse.cl"
#endif

// Where the rays of the camera begin.
#if HAS_INSTANCES
typedef scene_start_t world_start_t;
#else
typedef const global node_t *world_start_t;
#endif

typedef struct {
    world_start_t start;
    const global node_t *nodes;
    const global block_t *blocks;
    int block_count;
    const global bvh2_node_t *top_nodes;
    const global instance_t *instances;
    const global float *spheres;
} world_t;

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

// A position as a pair of floats: the low part is what float32 has rounded off. It is zero where there is no scene.
typedef struct {
    float3 high;
    float3 low;
} position_t;

// The surface that a ray has met, in the world's local coordinates.
typedef struct {
    float3 position;
    position_t above;  // just above the surface, on the ray's side of it
    position_t below;  // just below it
    float3 normal;     // geometric unit vector on the side of the ray's origin
    bool is_back;      // whether the ray comes from the side from which the corners of a triangle are clockwise
    int instance_id;   // 0 where there is no scene
    int prim_id;
    float u;
    float v;
#if HAS_SPHERES
    float sphere_radius;  // 0 for a triangle
#endif
} world_surface_t;

#if HAS_INSTANCES

// Pictures show all instances but those that no ray sees.
#define EVERY_MASK 0xffffffffu

typedef scene_ray_pair_t world_ray_t;

INLINED bool is_sphere(const world_t *world, const search_t *search)
{
#if HAS_SPHERES
    return world->instances[search->instance_index].kind == KIND_SPHERES;
#else
    return false;
#endif
}

INLINED world_start_t find_world_start(
    const global node_t *nodes, const global scene_tile_t *tiles, const global node_t *entry_points)
{
    return find_scene_start(tiles, entry_points);
}

INLINED world_ray_t make_world_ray(
    const position_t origin, const float3 direction, const float3 direction_low, const float t_max)
{
    const world_ray_t ray = {origin.high, direction, 0.0f, t_max, origin.low, direction_low, EVERY_MASK};
    return ray;
}

INLINED void traverse_world(
    const world_t *world, const world_ray_t *ray, const bool is_primary, search_t *search, const int query)
{
    const scene_start_t start = is_primary ? world->start : start_at_root();
    traverse_scene(
        world->top_nodes, world->instances, world->nodes, world->blocks, world->spheres, start, ray, search, query);
}

INLINED world_surface_t world_surface_at(const world_t *world, const world_ray_t *ray, const search_t *search)
{
    const placed_surface_t placed = scene_surface_at(world->instances, world->blocks, world->spheres, ray, search);
    world_surface_t surface = {
        placed.above, {placed.above, placed.above_low}, {placed.below, placed.below_low}, placed.normal,
        placed.is_back, search->instance_id, search->nearest.prim_id, search->nearest.u, search->nearest.v};
#if HAS_SPHERES
    surface.sphere_radius = placed.radius;
#endif
    return surface;
}

// A normal of the geometry that was hit, in the world's local coordinates; not of length 1. Normals are transformed by
// the transpose of the inverse.
INLINED float3 place_normal(const world_t *world, const search_t *search, const float3 normal)
{
    const global instance_t *instance = world->instances + search->instance_index;
    return normal.x * load3(instance->to_object[0]) + normal.y * load3(instance->to_object[1])
        + normal.z * load3(instance->to_object[2]);
}

// The edges from the first corner of the triangle that was hit to the others, in the world's local coordinates.
INLINED void world_edges(const world_t *world, const search_t *search, float3 *ab, float3 *ac)
{
    const global instance_t *instance = world->instances + search->instance_index;
    const global block_t *blocks = find_blocks(instance, world->blocks, world->spheres);
    const corners_t corners = corners_at(blocks, search->nearest.triangle_index);
    *ab = transform_vector(instance->to_scene, corners.b - corners.a);
    *ac = transform_vector(instance->to_scene, corners.c - corners.a);
}

// The lift of the point that was hit, for unit normals at the corners of its triangle, in the geometry's coordinates.
INLINED float3 world_lift(const world_t *world, const search_t *search, const float3 normals[3])
{
    const global instance_t *instance = world->instances + search->instance_index;
    const global block_t *blocks = find_blocks(instance, world->blocks, world->spheres);
    const corners_t corners = corners_at(blocks, search->nearest.triangle_index);
    return transform_vector(instance->to_scene, find_lift(&corners, &search->nearest, normals));
}

#else

typedef ray_t world_ray_t;

INLINED bool is_sphere(const world_t *world, const search_t *search)
{
    return false;
}

INLINED world_start_t find_world_start(
    const global node_t *nodes, const global scene_tile_t *tiles, const global node_t *entry_points)
{
    return find_start_node(nodes, entry_points);
}

INLINED world_ray_t make_world_ray(
    const position_t origin, const float3 direction, const float3 direction_low, const float t_max)
{
    return make_ray(origin.high, direction, 0.0f, t_max);
}

INLINED void traverse_world(
    const world_t *world, const world_ray_t *ray, const bool is_primary, search_t *search, const int query)
{
    const global node_t *start = is_primary ? world->start : world->nodes;
    traverse(world->nodes, start, world->blocks, world->block_count, ray, search, query);
}

INLINED world_surface_t world_surface_at(const world_t *world, const world_ray_t *ray, const search_t *search)
{
    const corners_t corners = corners_at(world->blocks, search->nearest.triangle_index);
    const surface_t tight = surface_at(&corners, &search->nearest, ray->direction);
    const surface_t own = with_even_error(&tight);
    const world_surface_t surface = {
        own.position, {point_above(&own), (float3)(0.0f)}, {point_below(&own), (float3)(0.0f)}, own.normal,
        own.is_back, 0, search->nearest.prim_id, search->nearest.u, search->nearest.v};
    return surface;
}

INLINED float3 place_normal(const world_t *world, const search_t *search, const float3 normal)
{
    return normal;
}

INLINED void world_edges(const world_t *world, const search_t *search, float3 *ab, float3 *ac)
{
    const corners_t corners = corners_at(world->blocks, search->nearest.triangle_index);
    *ab = corners.b - corners.a;
    *ac = corners.c - corners.a;
}

INLINED float3 world_lift(const world_t *world, const search_t *search, const float3 normals[3])
{
    const corners_t corners = corners_at(world->blocks, search->nearest.triangle_index);
    return find_lift(&corners, &search->nearest, normals);
}

#endif

// Whether anything lies between a position and t_max along a direction.
INLINED bool is_blocked(const world_t *world, const position_t from, const float3 direction, const float t_max)
{
    const world_ray_t ray = make_world_ray(from, direction, (float3)(0.0f), t_max);
    search_t blockers = make_search(1, 0);
    traverse_world(world, &ray, false, &blockers, QUERY_COUNT);
    return blockers.count > 0;
}
