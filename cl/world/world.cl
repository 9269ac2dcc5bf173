// The world that rays and points are cast at: one shape in its own place (LONE), or instances of shapes under a tree of
// their own.
//
// Arguments that all kernels share; those that a lone shape has no use for are NULL:
//
// nodes[], blocks[]        node_t, block_t: the trees of all shapes, one after the other, in their layout, see
//                          clbvh/structs.py; indices within a tree count from its own begin
// block_count              blocks of a lone shape
// top_nodes[]              bvh2_node_t: the tree over the instances, in the world's local coordinates
// instances[]              instance_t: in the order of that tree's leaves
// spheres[]                float: the blocks of the shapes that are spheres; those of a lone shape are `blocks`
//
// LONE, 1 unless the host defines it as 0: there is one shape, in its own place, and its local coordinates are the
// world's. KINDS: a bit for each kind of primitives that there may be; of a lone shape the one of its own.

// keep: files that both branches need are expanded before them
#include "boxes/aabb.cl"
#include "math/pairs.cl"
#include "math/vectors.cl"
#include "instances/instance.cl"
#include "prims/blocks.cl"
#include "traversal/entry_point.cl"
#if !LONE
#include "instances/start.cl"
#include "instances/traverse.cl"
#endif

#define WORLD_ARGUMENTS \
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count, \
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances, \
    const global float *restrict spheres, const global exact_instance_t *restrict exact_instances, \
    const global exact_real_t *restrict exact_vertices, const global int *restrict exact_faces, \
    const global exact_real_t *restrict exact_solids

// The initializer of a world_t from these arguments, and from where its rays begin.
#if EXACT
#define WORLD(start) \
    {(start), nodes, {blocks, spheres}, block_count, top_nodes, instances, \
     {exact_instances, exact_vertices, exact_faces, exact_solids}}
#else
#define WORLD(start) {(start), nodes, {blocks, spheres}, block_count, top_nodes, instances}
#endif

// The mask of rays that see all instances but those that no ray sees.
#define EVERY_MASK 0xffffffffu

// Where rays begin: of a lone shape a node, see traversal/entry_point.cl.
#if LONE
typedef const global node_t *start_t;
#else
typedef instance_start_t start_t;
#endif

typedef struct {
    start_t start;
    const global node_t *nodes;
    kind_blocks_t blocks;
    int block_count;
    const global bvh2_node_t *top_nodes;
    const global instance_t *instances;
#if EXACT
    exact_shapes_t shapes;
#endif
} world_t;

// A position as a pair of floats: the low part is what float32 has rounded off. It is not used with a lone shape.
typedef struct {
    float3 high;
    float3 low;
} position_t;

#if EXACT

typedef ray_pair_t world_ray_t;

INLINED world_ray_t make_world_ray(
    const position_t origin, const float3 direction, const float3 direction_low, const float t_max)
{
    return make_exact_pair(
        convert_double3(origin.high) + convert_double3(origin.low),
        convert_double3(direction) + convert_double3(direction_low), 0.0f, t_max, EVERY_MASK);
}

#elif LONE

typedef ray_t world_ray_t;

INLINED world_ray_t make_world_ray(
    const position_t origin, const float3 direction, const float3 direction_low, const float t_max)
{
    return make_ray(origin.high, direction, 0.0f, t_max);
}

#else

typedef ray_pair_t world_ray_t;

INLINED world_ray_t make_world_ray(
    const position_t origin, const float3 direction, const float3 direction_low, const float t_max)
{
    const world_ray_t ray = {origin.high, direction, 0.0f, t_max, origin.low, direction_low, EVERY_MASK};
    return ray;
}

#endif

#if LONE

INLINED start_t root_of(const global node_t *nodes)
{
    return nodes;
}

// Where the rays of a tile begin, see TILE_INDEX.
INLINED start_t find_start(
    const global node_t *nodes, const global tile_t *tiles, const global node_t *entry_points, const int tile_index)
{
    return find_start_node(nodes, entry_points, tile_index);
}

// Whether no ray with this start can hit anything.
INLINED bool meets_nothing(const start_t *start)
{
    return node_meets_nothing(*start);
}

// Reports the crossings of a ray to a search; the ray begins at the world's start, or else at the root.
INLINED void traverse_world(
    const world_t *world, const world_ray_t *ray, const bool at_start, search_t *search, const int query)
{
    const global node_t *start = at_start ? world->start : world->nodes;
#if EXACT
    world_ray_t own = *ray;
    own.shapes = world->shapes;
    const ray_t inside = enter_exactly(&own, 0, ray->t_max);
    traverse(world->nodes, start, world->blocks.own, world->block_count, &inside, search, query);
#else
    traverse(world->nodes, start, world->blocks.own, world->block_count, ray, search, query);
#endif
}

#else

INLINED start_t root_of(const global node_t *nodes)
{
    return start_at_root();
}

INLINED start_t find_start(
    const global node_t *nodes, const global tile_t *tiles, const global node_t *entry_points, const int tile_index)
{
    return find_instance_start(tiles, entry_points, tile_index);
}

INLINED bool meets_nothing(const start_t *start)
{
    return start->tile && start->tile->leaf_count == 0 && start->instance_index == NO_INSTANCE;
}

INLINED void traverse_world(
    const world_t *world, const world_ray_t *ray, const bool at_start, search_t *search, const int query)
{
#if EXACT
    world_ray_t own = *ray;
    own.shapes = world->shapes;
    ray = &own;
#endif
    traverse_instances(
        world->top_nodes, world->instances, world->nodes, world->blocks,
        at_start ? world->start : start_at_root(), ray, search, query);
}

#endif

// Whether a ray that begins at the root meets anything.
CALLED bool meets_anything(const world_t *world, const world_ray_t *ray)
{
    search_t search = make_search(1, 0);
    traverse_world(world, ray, false, &search, QUERY_COUNT);
    return search.count > 0;
}

// Whether anything lies between a position and t_max along a direction.
INLINED bool is_blocked(const world_t *world, const position_t from, const float3 direction, const float t_max)
{
    const world_ray_t ray = make_world_ray(from, direction, (float3)(0.0f), t_max);
    return meets_anything(world, &ray);
}
