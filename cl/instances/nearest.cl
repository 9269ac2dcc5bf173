// The primitive of a scene that is nearest to a point: depth first through the tree over the instances' boxes, nearer
// child first, and through the tree of each instance's geometry in between.
//
// The order of primitives is that of (distance, instance_id, prim_id). It does not depend on the layout, because every
// primitive that may be the first is tested, and its distance has the same bits in every layout.
//
// metrics[]    metric_record_t: of the instances, by their ids
//
// Other arguments that the kernels share: see instances/traverse.cl. Assumes TOP_STACK_SIZE as there.

#include "instances/blocks.cl"
#include "nearest/metric.cl"
#include "nearest/nearest.cl"

// A point in a scene.
typedef struct {
    float3 position;
    float3 position_low;
    uint mask;
} point_pair_t;

INLINED point_pair_t unpack_scene_point(const global scene_point_t *packed)
{
    const point_pair_t point = {load3(packed->position), load3(packed->position_low), packed->mask};
    return point;
}

// The nearest primitive so far.
typedef struct {
    float distance;  // in the scene's local coordinates
    world_prim_t prim;
} scene_nearest_t;

INLINED scene_nearest_t no_scene_nearest(void)
{
    const scene_nearest_t none = {INFINITY, {NO_PRIM, NO_PRIM}};
    return none;
}

INLINED bool is_visible(const point_pair_t *point, const global instance_t *instance)
{
    return (point->mask & instance->mask) != 0;
}

// Returns a search in an instance for a primitive that is not farther than `limit`, in the scene's local coordinates.
INLINED nearest_t make_nearest(
    const global instance_t *instance, const global metric_record_t *metrics, const point_pair_t *point,
    const float limit)
{
    const float3 way = way_to_instance(instance, point->position, point->position_low);
    nearest_t nearest;
    nearest.metric = make_metric(instance, metrics + instance->instance_id, way);
#if HAS_SPHERES
    nearest.kind = instance->kind;
#endif
    // Rounded up: what is too far loses later.
    nearest.distance = limit * nearest.metric.unit * (1.0f + ERROR_BOUND(8));
    nearest.distance_squared = nearest.distance * nearest.distance + FLT_MIN;
    nearest.prim_id = NO_PRIM;
    return nearest;
}

// Takes the primitive of an instance that is nearest to the point into account.
INLINED void visit_instance_near(
    const global instance_t *instance, const global metric_record_t *metrics, const global node_t *nodes,
    const global block_t *blocks, const global float *spheres, const point_pair_t *point, scene_nearest_t *best)
{
    if (!is_visible(point, instance)) {
        return;
    }
    nearest_t nearest = make_nearest(instance, metrics, point, best->distance);
    find_nearest(
        nodes + instance->first_node, find_blocks(instance, blocks, spheres), instance->block_count, &nearest);
    if (nearest.prim_id == NO_PRIM) {
        return;
    }
    const float distance = nearest.distance / nearest.metric.unit;
    const bool wins_tie = best->prim.prim_id == NO_PRIM || instance->instance_id < best->prim.instance_id;
    if (distance < best->distance || (distance == best->distance && wins_tie)) {
        best->distance = distance;
        best->prim.prim_id = nearest.prim_id;
        best->prim.instance_id = instance->instance_id;
    }
}

// Whether an instance in a child's box may be as near as the nearest so far; *distance_squared is that of the box.
INLINED bool may_instance_be_nearer(
    const global bvh2_node_t *top_nodes, const int child_slot, const float3 position, const float best_distance,
    float *distance_squared)
{
    const global bvh2_node_t *node = top_nodes + (child_slot >> 1);
    const float3 below = load3(node->aabb_min[child_slot & 1]) - position;
    const float3 above = load3(node->aabb_max[child_slot & 1]) - position;
    const float3 outside = fmax(fmax(below, -above), 0.0f);
    const float3 farthest = fmax(magnitude(below), magnitude(above));
    *distance_squared = dot_product(outside, outside);
    // The position is rounded, as are the distances of the instance's primitives.
    const float slack = ERROR_BOUND(32) * sum_of(farthest + magnitude(position));
    const float limit = best_distance + slack;
    // The box of a child that is not there is infinitely far, which is not farther than no instance at all.
    return *distance_squared <= limit * limit && *distance_squared < INFINITY;
}

INLINED world_prim_t find_nearest_in_scene(
    const global bvh2_node_t *top_nodes, const global instance_t *instances, const global metric_record_t *metrics,
    const global node_t *nodes, const global block_t *blocks, const global float *spheres,
    const point_pair_t *point)
{
    scene_nearest_t best = no_scene_nearest();
    int stack[TOP_STACK_SIZE];
    int stack_count = 0;
    // The children of a node are tested together; a stack entry is a child's slot, 2 * node + child.
    int node = 0;

    while (true) {
        float squared[2];
        bool may_be[2];
        for (int child = 0; child < 2; child++) {
            may_be[child] =
                may_instance_be_nearer(top_nodes, 2 * node + child, point->position, best.distance, squared + child);
        }
        int next = -1;
        if (may_be[0] && may_be[1]) {
            const int first = squared[1] < squared[0];
            stack[stack_count++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (may_be[0] || may_be[1]) {
            next = 2 * node + (may_be[1] ? 1 : 0);
        }

        // The instances of leaves are visited at once, until an interior node is next.
        while (next < 0 || top_nodes[next >> 1].count[next & 1] > 0) {
            if (next >= 0) {
                const int first = top_nodes[next >> 1].first[next & 1];
                const int end = first + top_nodes[next >> 1].count[next & 1];
                for (int index = first; index < end; index++) {
                    visit_instance_near(instances + index, metrics, nodes, blocks, spheres, point, &best);
                }
            }
            float distance_squared;
            do {
                if (stack_count == 0) {
                    return best.prim;
                }
                next = stack[--stack_count];
            } while (!may_instance_be_nearer(top_nodes, next, point->position, best.distance, &distance_squared));
        }
        node = top_nodes[next >> 1].first[next & 1];
    }
}
