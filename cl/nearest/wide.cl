// The primitive nearest to a point in the layouts `bvh4`, `bvh8` and `bvh8c`: depth first, nearest child first. A
// popped child is compared again, because the nearest distance may have become smaller.
//
// Assumes STACK_SIZE >= the most children on the stack at once, at least 1.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "prims/leaf.cl"
#include "traversal/wide.cl"

// Returns one bit per child, set where a primitive in its box may be as near as the nearest so far; *distance has the
// least distance that a primitive in each box can have.
INLINED uint children_may_be_nearer(const global node_t *node, const nearest_t *nearest, lanes_t *distance)
{
    const point_t lower = load_points(node->aabb_min);
    const point_t way = way_to_box(&nearest->metric, lower, load_points(node->aabb_max));
    *distance = larger_lanes(sqrt(dot_of(way, way)) / BOX_GROWTH - nearest->metric.slack, (lanes_t)(0.0f));
    // An inverted box has a huge or infinite distance, which the nearest distance may equal.
    const lane_mask_t is_child = lower.x <= load_lanes(node->aabb_max[0]);
    return mask_bits((*distance <= nearest->distance) & is_child);
}

INLINED void find_nearest(
    const global node_t *nodes, const global block_t *blocks, const int block_count, nearest_t *nearest)
{
    ulong stack[STACK_SIZE];
    int stack_count = 0;
    int next = 0;

    while (true) {
        if (next >= 0) {
            const global node_t *node = nodes + next;
            lanes_t distance;
            const uint near = children_may_be_nearer(node, nearest, &distance);
            if (near != 0) {
                const bool is_one = (near & (near - 1)) == 0;
                next = is_one ? node->child[lowest_bit(near)]
                              : push_children(node->child, near, distance, stack, &stack_count);
                continue;
            }
        } else {
            test_leaf(nearest, blocks, ~next);
        }
        ulong popped;
        do {
            if (stack_count == 0) {
                return;
            }
            popped = stack[--stack_count];
        } while (key_of(popped) > nearest->distance);
        next = child_of(popped);
    }
}
