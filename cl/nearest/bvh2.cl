// Nearest triangle in the `bvh2` layout: depth first, the nearer child first. A waiting child is held against the
// nearest triangle again when its turn comes.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1. A stack entry is 2 * node + child, in 4 bytes.

#include "nearest_one.cl"
#include "traverse_bvh2.cl"

INLINED bool may_child_be_nearer(const global node_t *nodes, const int entry, const nearest_t *nearest, float *distance)
{
    const global node_t *node = nodes + (entry >> 1);
    return may_be_nearer(
        nearest, vload3(0, node->aabb_min[entry & 1]), vload3(0, node->aabb_max[entry & 1]), distance);
}

INLINED void visit_nearest(
    const global node_t *nodes, const global group_t *groups, const int group_count, nearest_t *nearest)
{
    int stack[STACK_SIZE];
    int waiting = 0;
    int node = 0;

    while (true) {
        float left, right;
        const bool take_left = may_child_be_nearer(nodes, 2 * node, nearest, &left);
        const bool take_right = may_child_be_nearer(nodes, 2 * node + 1, nearest, &right);

        int next = -1;
        if (take_left && take_right) {
            const int first = right < left;
            stack[waiting++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (take_left || take_right) {
            next = 2 * node + (take_right ? 1 : 0);
        }

        // Leaves are tested at once, until an interior child comes up.
        while (next < 0 || nodes[next >> 1].count[next & 1] > 0) {
            if (next >= 0) {
                const int first = nodes[next >> 1].first[next & 1];
                const int end = first + nodes[next >> 1].count[next & 1];
                for (int place = first; place < end; place++) {
                    note_triangle(nearest, groups, place);
                }
            }
            float distance;
            do {
                if (waiting == 0) {
                    return;
                }
                next = stack[--waiting];
            } while (!may_child_be_nearer(nodes, next, nearest, &distance));
        }
        node = nodes[next >> 1].first[next & 1];
    }
}
