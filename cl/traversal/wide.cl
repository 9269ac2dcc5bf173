// Depth-first traversal of the `bvh4` and `bvh8` layouts: nodes with the boxes of all children, in lanes.
//
// Assumes STACK_SIZE >= the number of children that can wait, at least 1: the host compiles it in from the tree at
// hand. Where a waiting child's box is entered stays with it, for the queries that can do without the far ones.

#include "group.cl"
#include "slabs.cl"

// A child that waits: where its box is entered in the upper half, what the node says of it in the lower one. Entries
// are not negative, so these numbers have the order of the entries, and two of them change places without a branch.
INLINED ulong make_waiting(const float entry, const int child)
{
    return ((ulong)as_uint(entry) << 32) | (uint)child;
}

INLINED float entry_of(const ulong waiting)
{
    return as_float((uint)(waiting >> 32));
}

INLINED int child_of(const ulong waiting)
{
    return (int)(uint)waiting;
}

// Puts all children but the nearest on the stack, the nearer the higher, and returns the nearest. At least two are met.
INLINED int stack_children(const global int *child, uint met, const lanes_t entry, ulong *stack, int *waiting)
{
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } entered = {entry};

    // Two are the rule, and take no branch.
    const int lane_a = lowest_bit(met);
    met &= met - 1;
    const int lane_b = lowest_bit(met);
    met &= met - 1;
    const ulong a = make_waiting(entered.of_lane[lane_a], child[lane_a]);
    const ulong b = make_waiting(entered.of_lane[lane_b], child[lane_b]);
    ulong nearest = a < b ? a : b;
    const int bottom = *waiting;
    stack[bottom] = a < b ? b : a;
    int top = bottom + 1;

    // The others are sorted in.
    while (met != 0) {
        const int lane = lowest_bit(met);
        met &= met - 1;
        const ulong its = make_waiting(entered.of_lane[lane], child[lane]);
        const ulong farther = its < nearest ? nearest : its;
        nearest = its < nearest ? its : nearest;
        int place = top++;
        while (place > bottom && stack[place - 1] < farther) {
            stack[place] = stack[place - 1];
            place--;
        }
        stack[place] = farther;
    }
    *waiting = top;
    return child_of(nearest);
}

// Children that are not there come last, and their boxes are inside out.
INLINED bool has_children(const global node_t *node)
{
    return node->aabb_min[0][0] <= node->aabb_max[0][0];
}

// The nearest child first, and none that the ray enters behind what was found meanwhile.
INLINED void traverse_in_order(
    const global node_t *nodes, const global node_t *start, const global group_t *groups, const path_t *path,
    search_t *search, const int query)
{
    const sides_t sides = make_sides(nodes, path);
    const turn_t turn = make_turn(path);
    ulong stack[STACK_SIZE];
    int waiting = 0;
    const global node_t *from = start;
    int next = 0;

    while (true) {
        if (next >= 0) {
            const global node_t *node = from + next;
            from = nodes;
            const float limit = search_limit(search, path, query) * sides.limit_scale;
            lanes_t entry;
            const uint met = meets_children(node, &sides, limit, &entry);
            if (met != 0) {
                const bool is_one = (met & (met - 1)) == 0;
                next = is_one ? node->child[lowest_bit(met)]
                              : stack_children(node->child, met, entry, stack, &waiting);
                continue;
            }
        } else {
            intersect_group(groups, ~next, path, &turn, search, query);
            if (is_settled(search, query)) {
                return;
            }
        }

        const float new_limit = search_limit(search, path, query) * sides.limit_scale;
        ulong popped;
        do {
            if (waiting == 0) {
                return;
            }
            popped = stack[--waiting];
        } while (entry_of(popped) > new_limit);
        next = child_of(popped);
    }
}

// In the order of the children in their nodes: what waits is a node and which of its children, one entry for all of them.
INLINED void traverse_as_stored(
    const global node_t *nodes, const global node_t *start, const global group_t *groups, const path_t *path,
    search_t *search, const int query)
{
    const sides_t sides = make_sides(nodes, path);
    const turn_t turn = make_turn(path);
    const global int *stack[STACK_SIZE];
    uint left_on_stack[STACK_SIZE];
    int waiting = 0;
    const global node_t *node = start;

    while (true) {
        const float limit = search_limit(search, path, query) * sides.limit_scale;
        lanes_t entry;
        uint left = meets_children(node, &sides, limit, &entry);
        const global int *child = node->child;
        int next;
        do {
            if (left == 0) {
                if (waiting == 0) {
                    return;
                }
                waiting--;
                child = stack[waiting];
                left = left_on_stack[waiting];
            }
            next = child[lowest_bit(left)];
            left &= left - 1;
            if (next < 0) {
                intersect_group(groups, ~next, path, &turn, search, query);
                if (is_settled(search, query)) {
                    return;
                }
            }
        } while (next < 0);
        // Written always, and kept if there is anything left.
        stack[waiting] = child;
        left_on_stack[waiting] = left;
        waiting += left != 0;
        node = nodes + next;
    }
}

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global group_t *groups, const int group_count,
    const path_t *path, search_t *search, const int query)
{
    if (!has_children(start)) {
        return;
    }
    if (query == QUERY_CLOSEST) {
        traverse_in_order(nodes, start, groups, path, search, query);
    } else {
        // What is behind other crossings counts as well.
        traverse_as_stored(nodes, start, groups, path, search, query);
    }
}
