// Traversal of a scene: depth first through the tree over the instances' boxes, near child first, and through the tree
// of each instance's geometry in between.
//
// Arguments that the kernels of scenes share:
//
// top_nodes[]              bvh2_node_t: the tree over the instances, in the scene's local coordinates
// instances[]              instance_t: in the order of that tree's leaves
// nodes[], blocks[]        node_t, block_t: the trees of all geometries, one after the other; indices within a tree
//                          count from its own begin
// spheres[]                float: the blocks of the geometries that are spheres
//
// Assumes TOP_STACK_SIZE >= the depth of the tree over the instances, at least 1.

#include "boxes/aabb.cl"
#include "instances/blocks.cl"
#include "instances/instance.cl"
#include "traversal/traverse.cl"

// Reports each crossing of the ray with an instance to the search.
INLINED void visit_instance(
    const global instance_t *instances, const int index, const global node_t *nodes, const global block_t *blocks,
    const global float *spheres, const scene_ray_pair_t *ray, search_t *search, const int query)
{
    const global instance_t *instance = instances + index;
    if ((instance->mask & ray->mask) == 0) {
        return;
    }
    const global node_t *root = nodes + instance->first_node;
    const global block_t *own_blocks = find_blocks(instance, blocks, spheres);
    float t_max = ray->ray.t_max;
    if (query == QUERY_CLOSEST) {
        // A crossing as far as the nearest one so far may still win by its instance.
        const float limit = search->nearest.t + search->nearest.t * T_SLACK;
        t_max = smaller(limit, t_max);
    }
    float t_shift;
    const ray_t inside = enter_instance(ray, instance, t_max, &t_shift);

    if (query == QUERY_FIRST) {
        search->instance_id = instance->instance_id;
        search->t_shift = t_shift;
#if HAS_SPHERES
        search->kind = instance->kind;
#endif
        traverse(root, root, own_blocks, instance->block_count, &inside, search, query);
        return;
    }
    search_t own = make_search(search->max_count - search->count, 0);
#if HAS_SPHERES
    own.kind = instance->kind;
#endif
    traverse(root, root, own_blocks, instance->block_count, &inside, &own, query);
    if (query == QUERY_COUNT) {
        search->count += own.count;
    } else if (is_found(&own.nearest)) {
        own.nearest.t += t_shift;
        const float t = own.nearest.t;
        const float best = search->nearest.t;
        if (t < best || (t == best && instance->instance_id < search->instance_id)) {
            search->nearest = own.nearest;
            search->instance_id = instance->instance_id;
            search->instance_index = index;
        }
    }
}

// The largest t outside at which a crossing can still change the answer.
INLINED float scene_limit(const search_t *search, const ray_t *ray, const int query)
{
    if (query == QUERY_CLOSEST) {
        return smaller(search->nearest.t, ray->t_max);
    }
    return query == QUERY_FIRST && search->count >= search->max_count ? search->heap[0].t : ray->t_max;
}

INLINED void traverse_scene(
    const global bvh2_node_t *top_nodes, const global instance_t *instances, const global node_t *nodes,
    const global block_t *blocks, const global float *spheres, const scene_ray_pair_t *ray, search_t *search,
    const int query)
{
    const padded_ray_t padded = pad_ray(&ray->ray);
    int stack[TOP_STACK_SIZE];
    int stack_count = 0;
    // The children of a node are tested together; a stack entry is a child's slot, 2 * node + child.
    int node = 0;

    while (true) {
        const global bvh2_node_t *parent = top_nodes + node;
        const float limit = scene_limit(search, &ray->ray, query);
        float t_near[2];
        bool meets[2];
        for (int child = 0; child < 2; child++) {
            meets[child] = meets_aabb(
                load3(parent->aabb_min[child]), load3(parent->aabb_max[child]), &padded, limit, t_near + child);
        }
        int next = -1;
        if (meets[0] && meets[1]) {
            const int first = t_near[1] < t_near[0];
            stack[stack_count++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (meets[0] || meets[1]) {
            next = 2 * node + (meets[1] ? 1 : 0);
        } else if (stack_count > 0) {
            next = stack[--stack_count];
        } else {
            return;
        }

        // The instances of leaves are visited at once, until an interior node is next.
        while (top_nodes[next >> 1].count[next & 1] > 0) {
            const int first = top_nodes[next >> 1].first[next & 1];
            const int end = first + top_nodes[next >> 1].count[next & 1];
            for (int index = first; index < end; index++) {
                visit_instance(instances, index, nodes, blocks, spheres, ray, search, query);
                if (is_complete(search, query)) {
                    return;
                }
            }
            if (stack_count == 0) {
                return;
            }
            next = stack[--stack_count];
        }
        node = top_nodes[next >> 1].first[next & 1];
    }
}
