// Traversal of a scene: depth first through the tree over the instances' boxes, near child first, and through the tree
// of each instance's geometry in between.
//
// Arguments that the kernels of scenes share:
//
// top_nodes[]              bvh2_node_t: the tree over the instances, in the scene's local coordinates
// instances[]              instance_t: in the order of that tree's leaves
// nodes[], blocks          node_t and kind_blocks_t: the trees of all geometries, one after the other; indices within a
//                          tree count from its own begin
//
// Assumes TOP_STACK_SIZE >= the depth of the tree over the instances, at least 1.

#include "boxes/aabb.cl"
#include "instances/instance.cl"
#include "instances/start.cl"
#include "prims/blocks.cl"
#include "traversal/traverse.cl"

// Reports each crossing of the ray with an instance to the search. The ray begins at an entry point of the geometry's
// tree, or at its root if that is NULL.
INLINED void visit_instance(
    const global instance_t *instances, const int index, const global node_t *nodes, const kind_blocks_t blocks,
    const global node_t *entry_point, const ray_pair_t *ray, search_t *search, const int query)
{
    const global instance_t *instance = instances + index;
    if ((instance->mask & ray->mask) == 0) {
        return;
    }
    const global node_t *root = nodes + instance->first_node;
    const global node_t *start = entry_point ? entry_point : root;
    const global block_t *own_blocks = find_blocks(instance, blocks);
    float t_max = ray->t_max;
    if (query == QUERY_CLOSEST) {
        // A crossing as far as the nearest one so far may still win by its instance.
        const float limit = search->nearest.t + search->nearest.t * T_SLACK;
        t_max = smaller(limit, t_max);
    }
#if EXACT
    const ray_t inside = enter_exactly(ray, instance->instance_id, t_max);
    const double t_shift = inside.exact.t_shift;
#else
    float t_shift;
    const ray_t inside = enter_instance(ray, instance, t_max, &t_shift);
#endif

    const int excluded =
        search->excluded_prim.instance_id == instance->instance_id ? search->excluded_prim.prim_id : NO_PRIM;
    if (query == QUERY_FIRST) {
        search->excluded = excluded;
        search->instance_id = instance->instance_id;
        search->t_shift = t_shift;
        search->kind = instance->kind;
        traverse(root, start, own_blocks, instance->block_count, &inside, search, query);
        return;
    }
    search_t own = make_search(search->max_count - search->count, 0);
    own.excluded = excluded;
    own.side = search->side;
#if COUNT_STEPS
    own.steps = search->steps;
#endif
    own.kind = instance->kind;
    traverse(root, start, own_blocks, instance->block_count, &inside, &own, query);
    if (query == QUERY_COUNT) {
        search->count += own.count;
    } else if (is_found(&own.nearest)) {
#if EXACT
        make_exact(&inside, &own.nearest);
        set_exact_t(&own.nearest, exact_t_of(&own.nearest) + t_shift);
        const double t = exact_t_of(&own.nearest);
        const double best = is_found(&search->nearest) ? exact_t_of(&search->nearest) : INFINITY;
#else
        own.nearest.t += t_shift;
        const float t = own.nearest.t;
        const float best = search->nearest.t;
#endif
        if (t < best || (t == best && instance->instance_id < search->instance_id)) {
            search->nearest = own.nearest;
            search->instance_id = instance->instance_id;
            search->instance_index = index;
        }
    }
}

// A function for each query keeps the query a constant. The tree of an instance, which is nearly all of the work, gets
// the registers that the way from instance to instance would take. Binary trees are quicker with all in one function.
#if HAS_ENTRY_POINTS
#define VISITED APART
#else
#define VISITED INLINED
#endif

VISITED void visit_for_closest(
    const global instance_t *instances, const int index, const global node_t *nodes, const kind_blocks_t blocks,
    const global node_t *entry_point, const ray_pair_t *ray, search_t *search)
{
    visit_instance(instances, index, nodes, blocks, entry_point, ray, search, QUERY_CLOSEST);
}

VISITED void visit_for_count(
    const global instance_t *instances, const int index, const global node_t *nodes, const kind_blocks_t blocks,
    const global node_t *entry_point, const ray_pair_t *ray, search_t *search)
{
    visit_instance(instances, index, nodes, blocks, entry_point, ray, search, QUERY_COUNT);
}

VISITED void visit_for_first(
    const global instance_t *instances, const int index, const global node_t *nodes, const kind_blocks_t blocks,
    const global node_t *entry_point, const ray_pair_t *ray, search_t *search)
{
    visit_instance(instances, index, nodes, blocks, entry_point, ray, search, QUERY_FIRST);
}

INLINED void visit_for(
    const global instance_t *instances, const int index, const global node_t *nodes, const kind_blocks_t blocks,
    const global node_t *entry_point, const ray_pair_t *ray, search_t *search, const int query)
{
    if (query == QUERY_CLOSEST) {
        visit_for_closest(instances, index, nodes, blocks, entry_point, ray, search);
    } else if (query == QUERY_COUNT) {
        visit_for_count(instances, index, nodes, blocks, entry_point, ray, search);
    } else {
        visit_for_first(instances, index, nodes, blocks, entry_point, ray, search);
    }
}

// The largest t outside at which a crossing can still change the answer.
INLINED float world_limit(const search_t *search, const ray_pair_t *ray, const int query)
{
    if (query == QUERY_CLOSEST) {
        return smaller(search->nearest.t, ray->t_max) * LIMIT_GROWTH;
    }
    const bool is_full = query == QUERY_FIRST && search->count >= search->max_count;
    return (is_full ? search->heap[0].t : ray->t_max) * LIMIT_GROWTH;
}

// Where a ray is on its way from leaf to leaf of the tree over the instances.
typedef struct {
    padded_ray_t padded;
    const global tile_t *tile;  // its leaves, one after the other; NULL: the tree is traversed
    int next_leaf;                    // in the list of the tile
    int node;                         // whose children are tested next; NO_NODE if a stack entry is next
    int stack_count;
} top_walk_t;

#define NO_NODE -1
#define NO_LEAF -1

// Returns the slot, 2 * node + child, of the next leaf whose box the ray meets before `limit`; NO_LEAF after the last.
INLINED int find_next_leaf(
    const global bvh2_node_t *top_nodes, const float limit, const search_t *search, top_walk_t *walk, int *stack)
{
    if (walk->tile) {
        while (walk->next_leaf < walk->tile->leaf_count) {
            const int index = walk->next_leaf++;
            if (walk->tile->t_near[index] > limit) {
                return NO_LEAF;
            }
            const int slot = walk->tile->leaf[index];
            const global bvh2_node_t *parent = top_nodes + (slot >> 1);
            const float3 aabb_min = load3(parent->aabb_min[slot & 1]);
            const float3 aabb_max = load3(parent->aabb_max[slot & 1]);
            float t_near;
            if (meets_aabb(aabb_min, aabb_max, &walk->padded, limit, &t_near)) {
                return slot;
            }
        }
        return NO_LEAF;
    }

    // The children of a node are tested together; a stack entry is a child's slot.
    while (true) {
        int next = NO_LEAF;
        if (walk->node != NO_NODE) {
            COUNT(search, node_steps, 1);
            const int node = walk->node;
            walk->node = NO_NODE;
            const global bvh2_node_t *parent = top_nodes + node;
            float t_near[2];
            bool meets[2];
            for (int child = 0; child < 2; child++) {
                meets[child] = meets_aabb(
                    load3(parent->aabb_min[child]), load3(parent->aabb_max[child]), &walk->padded, limit,
                    t_near + child);
            }
            if (meets[0] && meets[1]) {
                const int first = t_near[1] < t_near[0];
                stack[walk->stack_count++] = 2 * node + 1 - first;
                next = 2 * node + first;
            } else if (meets[0] || meets[1]) {
                next = 2 * node + (meets[1] ? 1 : 0);
            }
        }
        if (next == NO_LEAF) {
            if (walk->stack_count == 0) {
                return NO_LEAF;
            }
            next = stack[--walk->stack_count];
        }
        if (top_nodes[next >> 1].count[next & 1] > 0) {
            return next;
        }
        walk->node = top_nodes[next >> 1].first[next & 1];
    }
}

INLINED void traverse_instances(
    const global bvh2_node_t *top_nodes, const global instance_t *instances, const global node_t *nodes,
    const kind_blocks_t blocks, const instance_start_t start,
    const ray_pair_t *ray, search_t *search, const int query)
{
#if HAS_ENTRY_POINTS
    if (start.instance_index != NO_INSTANCE) {
        visit_for(
            instances, start.instance_index, nodes, blocks, start.entry_point, ray, search, query);
        return;
    }
    if (start.tile && start.tile->leaf_count == 0) {
        return;
    }
#endif
    const ray_t rounded = rounded_ray(ray);
    int stack[TOP_STACK_SIZE];
    top_walk_t walk;
    walk.padded = pad_ray(&rounded);
    walk.tile = start.tile;
    walk.next_leaf = 0;
    walk.node = start.top_node;
    walk.stack_count = 0;
    while (true) {
        const int leaf = find_next_leaf(top_nodes, world_limit(search, ray, query), search, &walk, stack);
        if (leaf == NO_LEAF) {
            return;
        }
        const int first = top_nodes[leaf >> 1].first[leaf & 1];
        const int end = first + top_nodes[leaf >> 1].count[leaf & 1];
        for (int index = first; index < end; index++) {
            visit_for(instances, index, nodes, blocks, 0, ray, search, query);
            if (is_complete(search, query)) {
                return;
            }
        }
    }
}
