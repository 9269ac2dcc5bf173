// The instances that contain a point: closed meshes that a ray from the point crosses an odd number of times, and
// spheres in one of which the point is.

#include "instances/containing.cl"
#include "instances/nearest.cl"

// The direction in which crossings are counted, in the geometry's local coordinates. Any will do: a direction that no
// mesh is modelled along meets few edges exactly, where the traversal has the most to do.
#define GENERIC_DIRECTION ((float3)(0.374f, 0.621f, 0.689f))

// "All of them", for a search that counts crossings.
#define NO_LIMIT 0x7fffffff

#if HAS_SPHERES
INLINED bool is_in_spheres(
    const global node_t *nodes, const global block_t *blocks, const int block_count, const float3 point)
{
    nearest_t nearest;
    nearest.metric = make_local_metric(point);
    nearest.distance = 0.0f;
    nearest.distance_squared = 0.0f;
    nearest.prim_id = NO_PRIM;
    nearest.kind = KIND_BALLS;
    find_nearest(nodes, blocks, block_count, &nearest);
    return nearest.prim_id != NO_PRIM;
}
#endif

INLINED bool is_in_instance(
    const global instance_t *instance, const global node_t *nodes, const global block_t *blocks,
    const global float *spheres, const point_pair_t *point)
{
    const global node_t *root = nodes + instance->first_node;
    const global block_t *own_blocks = find_blocks(instance, blocks, spheres);
    const float3 way = way_to_instance(instance, point->position, point->position_low);
    const float3 position = transform_vector(instance->to_object, -way);
#if HAS_SPHERES
    if (instance->kind == KIND_SPHERES) {
        return is_in_spheres(root, own_blocks, instance->block_count, position);
    }
#endif
    const ray_t ray = make_ray(position, GENERIC_DIRECTION, 0.0f, INFINITY);
    search_t search = make_search(NO_LIMIT, 0);
    traverse(root, root, own_blocks, instance->block_count, &ray, &search, QUERY_COUNT);
    return search.count % 2 == 1;
}

// Whether a visible instance contains the point. With `deepest`, all such instances are visited, and *deepest becomes
// the primitive at the largest of the distances from the point to the surfaces of these instances.
INLINED bool is_in_scene(
    const global bvh2_node_t *top_nodes, const global instance_t *instances, const global metric_record_t *metrics,
    const global node_t *nodes, const global block_t *blocks, const global float *spheres,
    const point_pair_t *point, world_prim_t *deepest)
{
    bool is_inside = false;
    float depth = -1.0f;
    instance_walk_t walk;
    begin_walk(&walk, top_nodes, point->position);

    for (int index = next_containing(&walk, top_nodes, point->position); index >= 0;
         index = next_containing(&walk, top_nodes, point->position)) {
        const global instance_t *instance = instances + index;
        if (!is_visible(point, instance) || !is_in_instance(instance, nodes, blocks, spheres, point)) {
            continue;
        }
        if (!deepest) {
            return true;
        }
        is_inside = true;
        scene_nearest_t nearest = no_scene_nearest();
        visit_instance_near(instance, metrics, nodes, blocks, spheres, point, &nearest);
        const bool wins_tie = instance->instance_id < deepest->instance_id;
        if (nearest.distance > depth || (nearest.distance == depth && wins_tie)) {
            depth = nearest.distance;
            *deepest = nearest.prim;
        }
    }
    return is_inside;
}
