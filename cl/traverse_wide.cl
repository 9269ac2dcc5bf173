// Depth-first traversal of the `bvh4` and `bvh8` layouts: nodes with the boxes of all children, in lanes.
//
// Assumes STACK_SIZE >= the number of children that can wait, at least 1: the host compiles it in from the tree at
// hand. A stack entry is what the node says of the child, in 4 bytes; where its box is entered is kept beside it, for
// the queries that can do without the far ones.

#include "aabb.cl"
#include "group.cl"
#include "lanes.cl"

// Where in a node the rows are with the near and the far sides of the boxes along x, y and z, and the inverse direction
// for the far ones: see aabb.cl. Offsets, so that nothing is chosen at each node.
typedef struct {
    int3 near;
    int3 far;
    float3 inverse_far;
} sides_t;

INLINED sides_t make_sides(const path_t *path)
{
    // The minima are rows 0 to 2, the maxima rows 3 to 5.
    const int3 is_back = path->inverse < 0.0f;
    const int3 axis = (int3)(0, 1, 2);
    sides_t sides;
    sides.near = WIDTH * (axis + (is_back & 3));
    sides.far = WIDTH * (axis + (~is_back & 3));
    sides.inverse_far = path->inverse * SLAB_SLACK;
    return sides;
}

// The slab test of meets_aabb for all children of a node. Returns a bit for each that the ray meets before `limit`,
// which has its slack already.
INLINED uint meets_children(
    const global node_t *node, const path_t *path, const sides_t *sides, const float limit, lanes_t *entry)
{
    const global float *rows = (const global float *)node;
    const lanes_t near_x = load_lanes(rows + sides->near.x);
    const lanes_t near_y = load_lanes(rows + sides->near.y);
    const lanes_t near_z = load_lanes(rows + sides->near.z);
    const lanes_t far_x = load_lanes(rows + sides->far.x);
    const lanes_t far_y = load_lanes(rows + sides->far.y);
    const lanes_t far_z = load_lanes(rows + sides->far.z);
    *entry = larger_lanes(
        (near_x - path->origin.x) * path->inverse.x,
        larger_lanes(
            (near_y - path->origin.y) * path->inverse.y,
            larger_lanes((near_z - path->origin.z) * path->inverse.z, (lanes_t)(path->t_min))));
    const lanes_t leave = smaller_lanes(
        (far_x - path->origin.x) * sides->inverse_far.x,
        smaller_lanes(
            (far_y - path->origin.y) * sides->inverse_far.y,
            smaller_lanes((far_z - path->origin.z) * sides->inverse_far.z, (lanes_t)(limit))));
    return mask_bits(*entry <= leave);
}

// Puts all children but the nearest on the stack, the nearer the higher, and returns the nearest. At least two are met.
INLINED int stack_children(
    const global int *child, uint met, const lanes_t entry, int *stack, float *entries, int *waiting)
{
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } entered = {entry};

    // Two are the rule, and take no branch.
    const int one = lowest_bit(met);
    met &= met - 1;
    const int other = lowest_bit(met);
    met &= met - 1;
    const bool is_swapped = entered.of_lane[other] < entered.of_lane[one];
    int nearest = child[is_swapped ? other : one];
    float nearest_entry = entered.of_lane[is_swapped ? other : one];
    const int bottom = *waiting;
    stack[bottom] = child[is_swapped ? one : other];
    entries[bottom] = entered.of_lane[is_swapped ? one : other];
    int top = bottom + 1;

    // The others are sorted in.
    while (met != 0) {
        const int lane = lowest_bit(met);
        met &= met - 1;
        const float its_entry = entered.of_lane[lane];
        const int its_child = child[lane];
        const bool is_nearest = its_entry < nearest_entry;
        const float farther_entry = is_nearest ? nearest_entry : its_entry;
        const int farther = is_nearest ? nearest : its_child;
        nearest_entry = is_nearest ? its_entry : nearest_entry;
        nearest = is_nearest ? its_child : nearest;
        int place = top++;
        while (place > bottom && entries[place - 1] < farther_entry) {
            entries[place] = entries[place - 1];
            stack[place] = stack[place - 1];
            place--;
        }
        entries[place] = farther_entry;
        stack[place] = farther;
    }
    *waiting = top;
    return nearest;
}

INLINED void traverse(
    const global node_t *nodes, const global group_t *groups, const int group_count, const path_t *path,
    search_t *search, const int query)
{
    const sides_t sides = make_sides(path);
    const turn_t turn = make_turn(path);
    int stack[STACK_SIZE];
    float entries[STACK_SIZE];
    int waiting = 0;
    int next = 0;

    while (true) {
        const float limit = search_limit(search, path, query) * SLAB_SLACK;
        if (next >= 0) {
            // A node: the nearest child that the ray meets is next, the others wait.
            const global node_t *node = nodes + next;
            lanes_t entry;
            uint met = meets_children(node, path, &sides, limit, &entry);
            if (met != 0) {
                const uint others = met & (met - 1);
                if (others == 0) {
                    next = node->child[lowest_bit(met)];
                } else if (query != QUERY_COUNT) {
                    next = stack_children(node->child, met, entry, stack, entries, &waiting);
                } else {
                    // A count needs no order.
                    next = node->child[lowest_bit(met)];
                    for (met = others; met != 0; met &= met - 1) {
                        stack[waiting++] = node->child[lowest_bit(met)];
                    }
                }
                continue;
            }
        } else {
            intersect_group(groups, ~next, path, &turn, search, query);
            if (is_settled(search, query)) {
                return;
            }
        }

        // The next one that waits, unless the ray enters it behind what was found meanwhile.
        const float new_limit = search_limit(search, path, query) * SLAB_SLACK;
        do {
            if (waiting == 0) {
                return;
            }
            next = stack[--waiting];
        } while (query != QUERY_COUNT && entries[waiting] > new_limit);
    }
}
