// Depth-first traversal of the `bvh2` layout: 64-byte nodes that hold the boxes of both children.
//
// Assumes STACK_SIZE >= the depth of the tree, at least 1: the host compiles it in from the tree at hand. A stack
// entry is a child that waits, as 2 * node + child, in 4 bytes.

#include "aabb.cl"
#include "one_triangle.cl"

typedef bvh2_node_t node_t;

INLINED bool meets_child(
    const global node_t *node, const int child, const path_t *path, const float t_max, float *entry)
{
    return meets_aabb(load3(node->aabb_min[child]), load3(node->aabb_max[child]), path, t_max, entry);
}

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global group_t *groups, const int group_count,
    const path_t *path, search_t *search, const int query)
{
    int stack[STACK_SIZE];
    int waiting = 0;
    int node = 0;

    while (true) {
        // Which children does the ray meet, and which first?
        float entry_left, entry_right;
        const float limit = search_limit(search, path, query);
        const bool meets_left = meets_child(nodes + node, 0, path, limit, &entry_left);
        const bool meets_right = meets_child(nodes + node, 1, path, limit, &entry_right);

        int next;
        if (meets_left && meets_right) {
            const int first = entry_right < entry_left;
            stack[waiting++] = 2 * node + 1 - first;
            next = 2 * node + first;
        } else if (meets_left || meets_right) {
            next = 2 * node + (meets_right ? 1 : 0);
        } else if (waiting > 0) {
            next = stack[--waiting];
        } else {
            return;
        }

        // Leaves are tested at once, until an interior child comes up.
        while (nodes[next >> 1].count[next & 1] > 0) {
            const int first = nodes[next >> 1].first[next & 1];
            const int end = first + nodes[next >> 1].count[next & 1];
            for (int place = first; place < end; place++) {
                intersect_triangle(groups, place, path, search, query);
            }
            if (is_settled(search, query) || waiting == 0) {
                return;
            }
            next = stack[--waiting];
        }
        node = nodes[next >> 1].first[next & 1];
    }
}
