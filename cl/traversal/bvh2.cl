// Depth-first traversal of the `bvh2` layout, near child first: 64-byte nodes that hold the boxes of both children.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1; the host compiles it in for the tree at hand. A child is
// named by its slot, 2 * node + child, which is also the stack entry.

#include "boxes/aabb.cl"
#include "prims/single.cl"

typedef bvh2_node_t node_t;

INLINED bool meets_child(
    const global node_t *node, const int child, const padded_ray_t *ray, const float t_max, float *t_near)
{
    return meets_aabb(load3(node->aabb_min[child]), load3(node->aabb_max[child]), ray, t_max, t_near);
}

// A child as its parent has it: the node `first`, or a leaf of `count` primitives from `first` on.
typedef struct {
    int first;
    int count;
} child_t;

INLINED child_t child_at(const global node_t *nodes, const int slot)
{
    const global node_t *parent = nodes + (slot >> 1);
    const child_t child = {parent->first[slot & 1], parent->count[slot & 1]};
    return child;
}

// Returns the nearer child that is met, and pushes the other one if it is met, too. Assumes that at least one is.
INLINED child_t push_farther(
    const global node_t *nodes, const int node, const bool meets_left, const bool meets_right,
    const bool is_right_nearer, int *stack, int *stack_count)
{
    // Both are loaded with the boxes: the next node waits for no second load.
    const child_t left = child_at(nodes, 2 * node);
    const child_t right = child_at(nodes, 2 * node + 1);
    const bool is_right = meets_right && (!meets_left || is_right_nearer);
    if (meets_left && meets_right) {
        stack[(*stack_count)++] = 2 * node + (is_right ? 0 : 1);
    }
    const child_t nearer = {is_right ? right.first : left.first, is_right ? right.count : left.count};
    return nearer;
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
        COUNT(search, node_steps, 1);
        float t_near_left, t_near_right;
        const float limit = search_limit(search, ray, query);
        const bool meets_left = meets_child(nodes + node, 0, &padded, limit, &t_near_left);
        const bool meets_right = meets_child(nodes + node, 1, &padded, limit, &t_near_right);

        child_t next;
        if (meets_left || meets_right) {
            const bool is_right_nearer = t_near_right < t_near_left;
            next = push_farther(nodes, node, meets_left, meets_right, is_right_nearer, stack, &stack_count);
        } else if (stack_count > 0) {
            next = child_at(nodes, stack[--stack_count]);
        } else {
            return;
        }

        // Leaves are tested at once, until an interior node is next.
        while (next.count > 0) {
            COUNT(search, leaf_visits, 1);
            for (int prim_index = next.first; prim_index < next.first + next.count; prim_index++) {
                intersect_single(blocks, prim_index, ray, search, query);
            }
            if (is_complete(search, query) || stack_count == 0) {
                return;
            }
            next = child_at(nodes, stack[--stack_count]);
        }
        node = next.first;
    }
}
