// The shapes of a world that contain a point: closed meshes that a ray from the point crosses an odd number of times,
// and spheres in one of which the point is.

#include "world/nearest.cl"
#include "world/points.cl"
#if !LONE
#include "instances/containing.cl"
#endif

// The direction in which crossings are counted, in the geometry's local coordinates. Any will do: a direction that no
// mesh is modelled along meets few edges exactly, where the traversal has the most to do.
#define GENERIC_DIRECTION ((float3)(0.374f, 0.621f, 0.689f))

// "All of them", for a search that counts crossings.
#define NO_LIMIT 0x7fffffff

// The ray from a point along which crossings are counted, in the local coordinates of a shape: `position` is the point
// there.
INLINED ray_t
make_counting_ray(const world_t *world, const point_pair_t *point, const int instance_id, const float3 position)
{
#if EXACT
    const global exact_instance_t *instance = world->shapes.instances + instance_id;
    ray_pair_t ray = make_exact_pair(
        convert_double3(point->position) + convert_double3(point->position_low),
        transform_exactly(instance->to_world, convert_double3(GENERIC_DIRECTION)), 0.0f, INFINITY, point->mask);
    ray.shapes = world->shapes;
    return enter_exactly(&ray, instance_id, INFINITY);
#else
    return make_ray(position, GENERIC_DIRECTION, 0.0f, INFINITY);
#endif
}

// Whether a shape contains the point from which a ray begins.
INLINED bool is_in_shape(
    const global node_t *nodes, const global block_t *blocks, const int block_count, const int kind, const ray_t *ray)
{
#if HAS_SPHERES
    if (kind == KIND_SPHERES) {
        nearest_t nearest = make_nearest(make_lone_metric(ray->origin), KIND_BALLS);
        nearest.distance = nearest.distance_squared = 0.0f;
        find_nearest(nodes, blocks, block_count, &nearest);
        return nearest.prim_id != NO_PRIM;
    }
#endif
    search_t search = make_search(NO_LIMIT, 0);
    traverse(nodes, nodes, blocks, block_count, ray, &search, QUERY_COUNT);
    return search.count % 2 == 1;
}

#if !LONE

// Whether an instance is visible to a point, and contains it.
INLINED bool is_in_instance(const world_t *world, const global instance_t *instance, const point_pair_t *point)
{
    if (!is_visible(point, instance)) {
        return false;
    }
    const float3 way = way_to_instance(instance, point->position, point->position_low);
    const ray_t ray = make_counting_ray(
        world, point, instance->instance_id, transform_vector(instance->to_object, -way));
    return is_in_shape(
        world->nodes + instance->first_node, find_blocks(instance, world->blocks, world->spheres),
        instance->block_count, instance->kind, &ray);
}

// Returns the index of the next visible instance that contains a point, or -1 after the last one.
INLINED int next_around(const world_t *world, instance_walk_t *walk, const point_pair_t *point)
{
    int index;
    do {
        index = next_containing(walk, world->top_nodes, point->position);
    } while (index >= 0 && !is_in_instance(world, world->instances + index, point));
    return index;
}

#endif

// Whether the world contains a point: a lone shape, or a visible instance.
INLINED bool is_in_world(const world_t *world, const point_pair_t *point)
{
#if LONE
    const ray_t ray = make_counting_ray(world, point, 0, point->position);
    return point->mask != 0
        && is_in_shape(world->nodes, world->blocks, world->block_count, LONE_KIND, &ray);
#else
    instance_walk_t walk;
    begin_walk(&walk, world->top_nodes, point->position);
    return next_around(world, &walk, point) >= 0;
#endif
}

// The primitive at the largest of the distances from a point to the surfaces of the visible instances that contain it.
INLINED world_prim_t find_deepest(
    const world_t *world, const global metric_record_t *metrics, const point_pair_t *point)
{
    world_nearest_t deepest = no_world_nearest(no_heap());
#if LONE
    return is_in_world(world, point) ? find_world_nearest(world, metrics, point, no_heap()).prim : deepest.prim;
#else
    instance_walk_t walk;
    begin_walk(&walk, world->top_nodes, point->position);
    int index;
    while ((index = next_around(world, &walk, point)) >= 0) {
        const global instance_t *instance = world->instances + index;
        world_nearest_t nearest = no_world_nearest(no_heap());
        visit_instance_near(world, instance, metrics, point, &nearest);
        const bool is_first = deepest.prim.prim_id == NO_PRIM;
        const bool wins_tie = instance->instance_id < deepest.prim.instance_id;
        if (is_first || nearest.distance > deepest.distance || (nearest.distance == deepest.distance && wins_tie)) {
            deepest = nearest;
        }
    }
    return deepest.prim;
#endif
}
