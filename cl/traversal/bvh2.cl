// Depth-first traversal of the `bvh2` layout, near child first: 64-byte nodes that hold the boxes of both children.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1; the host compiles it in for the tree at hand. A child is
// named by its slot, 2 * node + child, which is also the stack entry.

#include "boxes/aabb.cl"
#include "traversal/single.cl"

typedef bvh2_node_t node_t;

INLINED bool meets_child(
    const global node_t *node, const int child, const padded_ray_t *ray, const float t_max, float *t_near)
{
    return meets_aabb(load3(node->aabb_min[child]), load3(node->aabb_max[child]), ray, t_max, t_near);
}

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const int block_count,
    const ray_t *ray, search_t *search, const int query)
{
    const padded_ray_t padded = pad_ray(ray);
    int stack[STACK_SIZE];
    int stack_count = 0;
    int node = 0;

    while (true) {
        float t_near_left, t_near_right;
        const float limit = search_limit(search, ray, query);
        const bool meets_left = meets_child(nodes + node, 0, &padded, limit, &t_near_left);
        const bool meets_right = meets_child(nodes + node, 1, &padded, limit, &t_near_right);

        int next;
        if (meets_left && meets_right) {
            const int first = t_near_right < t_near_left;
            stack[stack_count++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (meets_left || meets_right) {
            next = 2 * node + (meets_right ? 1 : 0);
        } else if (stack_count > 0) {
            next = stack[--stack_count];
        } else {
            return;
        }

        // Leaves are tested at once, until an interior node is next.
        while (nodes[next >> 1].count[next & 1] > 0) {
            const int first = nodes[next >> 1].first[next & 1];
            const int end = first + nodes[next >> 1].count[next & 1];
            for (int prim_index = first; prim_index < end; prim_index++) {
                intersect_single(blocks, prim_index, ray, search, query);
            }
            if (is_complete(search, query) || stack_count == 0) {
                return;
            }
            next = stack[--stack_count];
        }
        node = nodes[next >> 1].first[next & 1];
    }
}
