// The shapes of a world that contain a point: closed meshes that a ray from the point crosses an odd number of times,
// and spheres in one of which the point is. Faces that coincide may count once.
//
// surplus[]         uint: a bit for each face of a mesh, set if its crossings do not count; the bits of all meshes that
//                   have such faces, one after the other; NULL if none has
// first_surplus[]   where the bits of each instance begin in surplus[], by its id; -1: no bit is set

#include "world/nearest.cl"
#if !LONE
#include "instances/containing.cl"
#endif

// The direction in which crossings are counted, in the geometry's local coordinates. Any will do: a direction that no
// mesh is modelled along meets few edges exactly, where the traversal has the most to do.
#define GENERIC_DIRECTION ((float3)(0.374f, 0.621f, 0.689f))

#define SURPLUS_ARGUMENTS const global uint *restrict surplus, const global int *restrict first_surplus

// The faces that do not count; the initializer is {surplus, first_surplus}.
typedef struct {
    const global uint *bits;
    const global int *first;
} surplus_t;

// The bits of an instance's faces, or NULL.
INLINED const global uint *find_surplus(const surplus_t *surplus, const int instance_id)
{
    return surplus->bits && surplus->first[instance_id] >= 0 ? surplus->bits + surplus->first[instance_id] : 0;
}

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
    const global node_t *nodes, const global block_t *blocks, const int block_count, const int kind, const ray_t *ray,
    const global uint *surplus)
{
    if (!IS_TRIANGLES(kind)) {
        nearest_t nearest = make_nearest(make_lone_metric(ray->origin, (float3)(0.0f)), kind);
        nearest.is_of_inside = true;
        nearest.distance = nearest.distance_squared = 0.0f;
        find_nearest(nodes, blocks, block_count, &nearest);
        return nearest.prim_id != NO_PRIM;
    }
    search_t search = make_search(1, 0);
    search.surplus = surplus;
    traverse(nodes, nodes, blocks, block_count, ray, &search, QUERY_PARITY);
    return search.count % 2 == 1;
}

#if !LONE

// Whether an instance is visible to a point, and contains it.
INLINED bool is_in_instance(
    const world_t *world, const surplus_t *surplus, const global instance_t *instance, const point_pair_t *point)
{
    if (!is_visible(point, instance)) {
        return false;
    }
    const float3 way = way_to_instance(instance, point);
    const ray_t ray = make_counting_ray(
        world, point, instance->instance_id, transform_vector(instance->to_object, -way));
    return is_in_shape(
        world->nodes + instance->first_node, find_blocks(instance, world->blocks),
        instance->block_count, instance->kind, &ray, find_surplus(surplus, instance->instance_id));
}

// Returns the index of the next visible instance that contains a point, or -1 after the last one.
INLINED int next_around(
    const world_t *world, const surplus_t *surplus, instance_walk_t *walk, const point_pair_t *point)
{
    int index;
    do {
        index = next_containing(walk, world->top_nodes, point->position);
    } while (index >= 0 && !is_in_instance(world, surplus, world->instances + index, point));
    return index;
}

#endif

// Whether the world contains a point: a lone shape, or a visible instance.
INLINED bool is_in_world(const world_t *world, const surplus_t *surplus, const point_pair_t *point)
{
#if LONE
    const ray_t ray = make_counting_ray(world, point, 0, point->position);
    return point->mask != 0
        && is_in_shape(world->nodes, world->blocks.own, world->block_count, ONLY_KIND, &ray, surplus->bits);
#else
    instance_walk_t walk;
    begin_walk(&walk, world->top_nodes, point->position);
    return next_around(world, surplus, &walk, point) >= 0;
#endif
}

// The primitive at the largest of the distances from a point to the surfaces of the visible instances that contain it.
INLINED world_prim_t find_deepest(
    const world_t *world, const surplus_t *surplus, const global metric_record_t *metrics, const point_pair_t *point)
{
    world_nearest_t deepest = no_world_nearest(point, no_heap());
#if LONE
    const bool is_inside = is_in_world(world, surplus, point);
    return is_inside ? find_world_nearest(world, metrics, point, no_heap()).prim : deepest.prim;
#else
    instance_walk_t walk;
    begin_walk(&walk, world->top_nodes, point->position);
    int index;
    while ((index = next_around(world, surplus, &walk, point)) >= 0) {
        const global instance_t *instance = world->instances + index;
        world_nearest_t nearest = no_world_nearest(point, no_heap());
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
