// The primitive nearest to a point in the `bvh2` layout: depth first, nearer child first. A popped child is tested
// again, because the nearest distance may have become smaller.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1. A child is named by its slot, 2 * node + child, which is
// also the stack entry.

#include "nearest/search.cl"
#include "prims/single.cl"
#include "traversal/bvh2.cl"

INLINED bool may_child_be_nearer(
    const global node_t *nodes, const int child_slot, const nearest_t *nearest, float *distance_squared)
{
    const global node_t *node = nodes + (child_slot >> 1);
    return may_be_nearer(
        nearest, load3(node->aabb_min[child_slot & 1]), load3(node->aabb_max[child_slot & 1]),
        distance_squared);
}

INLINED void find_nearest(
    const global node_t *nodes, const global block_t *blocks, const int block_count, nearest_t *nearest)
{
    int stack[STACK_SIZE];
    int stack_count = 0;
    int node = 0;

    while (true) {
        float left_squared, right_squared;
        const bool take_left = may_child_be_nearer(nodes, 2 * node, nearest, &left_squared);
        const bool take_right = may_child_be_nearer(nodes, 2 * node + 1, nearest, &right_squared);

        child_t next = {0, 0};
        bool is_found = take_left || take_right;
        if (is_found) {
            const bool is_right_nearer = right_squared < left_squared;
            next = push_farther(nodes, node, take_left, take_right, is_right_nearer, stack, &stack_count);
        }

        // Leaves are tested at once, until an interior node is next.
        while (!is_found || next.count > 0) {
            for (int prim_index = next.first; prim_index < next.first + next.count; prim_index++) {
                test_single(nearest, blocks, prim_index);
            }
            int slot;
            float distance_squared;
            do {
                if (stack_count == 0) {
                    return;
                }
                slot = stack[--stack_count];
            } while (!may_child_be_nearer(nodes, slot, nearest, &distance_squared));
            next = child_at(nodes, slot);
            is_found = true;
        }
        node = next.first;
    }
}
