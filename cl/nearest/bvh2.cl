// The primitive nearest to a point in the `bvh2` layout: depth first, nearer child first. A popped child is tested
// again, because the nearest distance may have become smaller.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1. A child is named by its slot, 2 * node + child, which is
// also the stack entry.

#include "nearest/single.cl"
#include "traversal/bvh2.cl"

INLINED bool may_child_be_nearer(
    const global node_t *nodes, const int child_slot, const nearest_t *nearest, float *distance_squared)
{
    const global node_t *node = nodes + (child_slot >> 1);
    return may_be_nearer(
        nearest, vload3(0, node->aabb_min[child_slot & 1]), vload3(0, node->aabb_max[child_slot & 1]),
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

        int next = -1;
        if (take_left && take_right) {
            const int first = right_squared < left_squared;
            stack[stack_count++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (take_left || take_right) {
            next = 2 * node + (take_right ? 1 : 0);
        }

        // Leaves are tested at once, until an interior node is next.
        while (next < 0 || nodes[next >> 1].count[next & 1] > 0) {
            if (next >= 0) {
                const int first = nodes[next >> 1].first[next & 1];
                const int end = first + nodes[next >> 1].count[next & 1];
                for (int prim_index = first; prim_index < end; prim_index++) {
                    test_single(nearest, blocks, prim_index);
                }
            }
            float distance_squared;
            do {
                if (stack_count == 0) {
                    return;
                }
                next = stack[--stack_count];
            } while (!may_child_be_nearer(nodes, next, nearest, &distance_squared));
        }
        node = nodes[next >> 1].first[next & 1];
    }
}
