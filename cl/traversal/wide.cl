// Depth-first traversal of the layouts `bvh4`, `bvh8` and `bvh8c`: nodes that hold the boxes of all children, in lanes.
//
// Assumes STACK_SIZE >= the most children on the stack at once, at least 1; the host compiles it in for the tree at
// hand. A stack entry keeps t_near of the child's box: a popped child beyond the nearest hit is skipped without a test.

#include "boxes/slabs.cl"
#include "prims/leaf.cl"
#include "triangles/block.cl"

// A stack entry: a key in the upper half, the node's `child` in the lower one. The key is t_near of the child's box, or
// its distance from a point; it is never negative, so its bits as an integer keep its order, and stack entries are
// sorted without branches.
INLINED ulong make_stack_entry(const float key, const int child)
{
    return ((ulong)as_uint(key) << 32) | (uint)child;
}

INLINED float key_of(const ulong stack_entry)
{
    return as_float((uint)(stack_entry >> 32));
}

INLINED int child_of(const ulong stack_entry)
{
    return (int)(uint)stack_entry;
}

// Pushes all children that are met but the nearest, nearer ones above farther ones, and returns the nearest. Assumes
// that at least two are met.
INLINED int push_children(
    const global int *child, uint met, const lanes_t key, ulong *stack, int *stack_count)
{
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } keys = {key};

    // Two children are the common case, and take no branch.
    const int lane_a = lowest_bit(met);
    met &= met - 1;
    const int lane_b = lowest_bit(met);
    met &= met - 1;
    const ulong a = make_stack_entry(keys.of_lane[lane_a], child[lane_a]);
    const ulong b = make_stack_entry(keys.of_lane[lane_b], child[lane_b]);
    ulong nearest = a < b ? a : b;
    const int bottom = *stack_count;
    stack[bottom] = a < b ? b : a;
    int top = bottom + 1;

    // Further children are inserted in order.
    while (met != 0) {
        const int lane = lowest_bit(met);
        met &= met - 1;
        const ulong other = make_stack_entry(keys.of_lane[lane], child[lane]);
        const ulong farther = other < nearest ? nearest : other;
        nearest = other < nearest ? other : nearest;
        int slot = top++;
        while (slot > bottom && stack[slot - 1] < farther) {
            stack[slot] = stack[slot - 1];
            slot--;
        }
        stack[slot] = farther;
    }
    *stack_count = top;
    return child_of(nearest);
}

// Missing children come last in a node, and their boxes are inverted.
INLINED bool has_children(const global node_t *node)
{
    return node->aabb_min[0][0] <= node->aabb_max[0][0];
}

// Takes the next child from the stack, of those that the ray enters before `limit`; returns whether there is one.
INLINED bool pop_child(const ulong *stack, int *stack_count, const float limit, int *child)
{
    while (*stack_count > 0) {
        const ulong popped = stack[--*stack_count];
        if (!(key_of(popped) > limit)) {
            *child = child_of(popped);
            return true;
        }
    }
    return false;
}

// Visits the nearest child first, and skips children whose boxes the ray enters beyond the nearest hit so far.
INLINED void traverse_in_order(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const ray_t *ray,
    search_t *search, const int query)
{
    const slabs_t slabs = make_slabs(ray);
    float limit = search_limit(search, ray, query) * slabs.unit;
    const global node_t *node = start;
    COUNT(search, node_steps, 1);
    lanes_t t_near;
    uint met = meets_children(node, &slabs, limit, &t_near);
    // Before the numbers of the triangle test: many rays meet nothing.
    if (met == 0) {
        return;
    }
    const axis_permutation_t permutation = make_axis_permutation(ray);
    ulong stack[STACK_SIZE];
    int stack_count = 0;

    while (true) {
        int next;
        if (met != 0) {
            const bool is_one = (met & (met - 1)) == 0;
            next = is_one ? node->child[lowest_bit(met)]
                          : push_children(node->child, met, t_near, stack, &stack_count);
        } else if (!pop_child(stack, &stack_count, limit, &next)) {
            return;
        }
        while (next < 0) {
            intersect_leaf(blocks, ~next, ray, &permutation, search, query);
            limit = search_limit(search, ray, query) * slabs.unit;
            if (is_complete(search, query) || !pop_child(stack, &stack_count, limit, &next)) {
                return;
            }
        }
        node = nodes + next;
        COUNT(search, node_steps, 1);
        met = meets_children(node, &slabs, limit, &t_near);
    }
}

// Visits children in the order of their node. One stack entry holds all remaining children of a node: its `child` array
// and their bits.
INLINED void visit_as_stored(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const ray_t *ray,
    const slabs_t *slabs, const axis_permutation_t *permutation, search_t *search, const int query)
{
    const global int *child_stack[STACK_SIZE];
    uint remaining_stack[STACK_SIZE];
    int stack_count = 0;
    const global node_t *node = start;

    while (true) {
        const float limit = search_limit(search, ray, query) * slabs->unit;
        COUNT(search, node_steps, 1);
        lanes_t t_near;
        uint remaining = meets_children(node, slabs, limit, &t_near);
        const global int *child = node->child;
        int next;
        do {
            if (remaining == 0) {
                if (stack_count == 0) {
                    return;
                }
                stack_count--;
                child = child_stack[stack_count];
                remaining = remaining_stack[stack_count];
            }
            next = child[lowest_bit(remaining)];
            remaining &= remaining - 1;
            if (next < 0) {
                intersect_leaf(blocks, ~next, ray, permutation, search, query);
                if (is_complete(search, query)) {
                    return;
                }
            }
        } while (next < 0);
        // Always written, and kept if children remain: no branch.
        child_stack[stack_count] = child;
        remaining_stack[stack_count] = remaining;
        stack_count += remaining != 0;
        node = nodes + next;
    }
}

INLINED void traverse_as_stored(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const ray_t *ray,
    search_t *search, const int query)
{
    const slabs_t slabs = make_slabs(ray);
    const axis_permutation_t permutation = make_axis_permutation(ray);
    visit_as_stored(nodes, start, blocks, ray, &slabs, &permutation, search, query);
}

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global block_t *blocks, const int block_count,
    const ray_t *ray, search_t *search, const int query)
{
    if (!has_children(start)) {
        return;
    }
    if (query == QUERY_CLOSEST) {
        traverse_in_order(nodes, start, blocks, ray, search, query);
    } else {
        // Crossings behind others count as well, so the order of the children does not matter.
        traverse_as_stored(nodes, start, blocks, ray, search, query);
    }
}
