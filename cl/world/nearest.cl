// The primitives of a world that are nearest to a point: depth first through the tree over the instances' boxes, nearer
// child first, and through the tree of each instance's shape in between.
//
// The order of primitives is that of (distance, instance_id, prim_id). It does not depend on the layout, because every
// primitive that may be the first is tested, and its distance has the same bits in every layout.
//
// metrics[]    metric_record_t of each instance, by instance_id; a lone shape has one, too, and does not read it
//
// Other arguments that the kernels share: see world/world.cl. Assumes TOP_STACK_SIZE as in instances/traverse.cl.

// keep: what kernels are given is expanded before the branches of layouts
#include "world/points.cl"
#include "nearest/nearest.cl"

// The nearest primitives so far.
typedef struct {
    float distance;  // in the world's local coordinates; with a heap, see near_heap_t, that of the farthest in it
    world_prim_t prim;
    near_heap_t kept;
} world_nearest_t;

// Nothing yet, for a point that looks no farther than its limit.
INLINED world_nearest_t no_world_nearest(const point_pair_t *point, const near_heap_t heap)
{
    world_nearest_t none = {point->limit, {NO_PRIM, NO_PRIM}, heap};
    none.kept.limit = point->limit;
    return none;
}

#if !LONE

// Takes the primitives of an instance into account.
INLINED void visit_instance_near(
    const world_t *world, const global instance_t *instance, const global metric_record_t *metrics,
    const point_pair_t *point, world_nearest_t *best)
{
    if (!is_visible(point, instance)) {
        return;
    }
    const float3 way = way_to_instance(instance, point);
    const metric_t metric =
        make_metric(instance, metrics + instance->instance_id, way, point->is_box, point->half_sides);
    nearest_t nearest = make_nearest(metric, instance->kind);
    nearest.is_of_box = point->is_box;
    nearest.instance_id = instance->instance_id;
    nearest.kept = best->kept;
    limit_distance(&nearest, best->distance);
    if (best->prim.prim_id == NO_PRIM) {
        grow_limit(&nearest);
    }
    find_nearest(
        world->nodes + instance->first_node, find_blocks(instance, world->blocks),
        instance->block_count, &nearest);
    if (best->kept.heap) {
        best->kept = nearest.kept;
        best->distance = farthest_kept(&nearest.kept);
        return;
    }
    if (nearest.prim_id == NO_PRIM) {
        return;
    }
    const float distance = nearest.distance / nearest.metric.unit;
    const bool wins_tie = best->prim.prim_id == NO_PRIM || instance->instance_id < best->prim.instance_id;
    if (distance < best->distance || (distance == best->distance && wins_tie) || best->prim.prim_id == NO_PRIM) {
        best->distance = distance;
        best->prim.prim_id = nearest.prim_id;
        best->prim.instance_id = instance->instance_id;
    }
}

// Whether an instance in a child's box may be as near as the nearest so far; *distance_squared is that of the box.
INLINED bool may_instance_be_nearer(
    const global bvh2_node_t *top_nodes, const int child_slot, const point_pair_t *point, const float best_distance,
    float *distance_squared)
{
    const global bvh2_node_t *node = top_nodes + (child_slot >> 1);
    const float3 position = point->position;
    const float3 below = load3(node->aabb_min[child_slot & 1]) - position;
    const float3 above = load3(node->aabb_max[child_slot & 1]) - position;
    const float3 outside = fmax(fmax(below, -above) - point->half_sides, 0.0f);
    const float3 farthest = fmax(magnitude(below), magnitude(above));
    *distance_squared = dot_product(outside, outside);
    // The position is rounded, as are the distances of the instance's primitives.
    const float slack = ERROR_BOUND(32) * sum_of(farthest + magnitude(position));
    const float limit = best_distance + slack;
    // The box of a child that is not there is infinitely far, which is not farther than no instance at all.
    return *distance_squared <= limit * limit && *distance_squared < INFINITY;
}

#endif

// Finds the nearest primitive, or, with a heap, as many as it has room for.
INLINED world_nearest_t find_world_nearest(
    const world_t *world, const global metric_record_t *metrics, const point_pair_t *point, const near_heap_t heap)
{
    world_nearest_t best = no_world_nearest(point, heap);
#if LONE
    if (point->mask == 0) {
        return best;
    }
    nearest_t nearest = make_nearest(make_lone_metric(point->position, point->half_sides), ONLY_KIND);
    nearest.is_of_box = point->is_box;
    nearest.kept = best.kept;
    limit_distance(&nearest, point->limit);
    grow_limit(&nearest);
    find_nearest(world->nodes, world->blocks.own, world->block_count, &nearest);
    best.prim.prim_id = nearest.prim_id;
    best.prim.instance_id = nearest.prim_id == NO_PRIM ? NO_PRIM : 0;
    best.kept = nearest.kept;
    return best;
#else
    int stack[TOP_STACK_SIZE];
    int stack_count = 0;
    // The children of a node are tested together; a stack entry is a child's slot, 2 * node + child.
    int node = 0;

    while (true) {
        float squared[2];
        bool may_be[2];
        for (int child = 0; child < 2; child++) {
            may_be[child] = may_instance_be_nearer(
                world->top_nodes, 2 * node + child, point, best.distance, squared + child);
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
        while (next < 0 || world->top_nodes[next >> 1].count[next & 1] > 0) {
            if (next >= 0) {
                const int first = world->top_nodes[next >> 1].first[next & 1];
                const int end = first + world->top_nodes[next >> 1].count[next & 1];
                for (int index = first; index < end; index++) {
                    visit_instance_near(world, world->instances + index, metrics, point, &best);
                }
            }
            float distance_squared;
            do {
                if (stack_count == 0) {
                    return best;
                }
                next = stack[--stack_count];
            } while (!may_instance_be_nearer(world->top_nodes, next, point, best.distance, &distance_squared));
        }
        node = world->top_nodes[next >> 1].first[next & 1];
    }
#endif
}
