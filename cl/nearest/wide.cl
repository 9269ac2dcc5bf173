// The primitive nearest to a point in the layouts `bvh4`, `bvh8` and `bvh8c`: depth first, nearest child first. A
// popped child is compared again, because the nearest distance may have become smaller.
//
// Assumes STACK_SIZE >= the most children on the stack at once, at least 1.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "traversal/wide.cl"
#if HAS_SPHERES
#include "nearest/sphere.cl"
#endif

// Three rows of a node or of a block of spheres.
INLINED point_t load_points(const global float rows[3][WIDTH])
{
    const point_t points = {load_lanes(rows[0]), load_lanes(rows[1]), load_lanes(rows[2])};
    return points;
}

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

// One corner of each triangle in the coordinates whose zero is the point.
INLINED point_t place_corners(const nearest_t *nearest, const leaf_t leaf, const int corner)
{
    return place_point(
        &nearest->metric, load_row(leaf, corner, 0), load_row(leaf, corner, 1), load_row(leaf, corner, 2));
}

typedef union {
    lanes_t lanes;
    float of_lane[WIDTH];
} distances_t;

// Degenerate triangles are NaN, which is never near.
INLINED void test_triangles(nearest_t *nearest, const leaf_t leaf)
{
    distances_t upper;
    const distances_t squared = {squared_to_triangle(
        &nearest->metric, place_corners(nearest, leaf, 0), place_corners(nearest, leaf, 1),
        place_corners(nearest, leaf, 2), &upper.lanes)};
    uint near = mask_bits(squared.lanes <= nearest->distance_squared) & lanes_in(leaf);
    for (; near != 0; near &= near - 1) {
        const int lane = lowest_bit(near);
        add_distance(nearest, squared.of_lane[lane], upper.of_lane[lane], prim_id_of(leaf, lane));
    }
}

#if HAS_SPHERES

// Lanes without a sphere are NaN.
INLINED void test_spheres(nearest_t *nearest, const global sphere_block_t *spheres)
{
    const distances_t squared = {
        distance_squared_to_sphere(nearest, load_points(spheres->centre), load_lanes(spheres->radius))};
    for (uint near = mask_bits(squared.lanes <= nearest->distance_squared); near != 0; near &= near - 1) {
        const int lane = lowest_bit(near);
        add_distance(nearest, squared.of_lane[lane], INFINITY, spheres->prim_id[lane]);
    }
}

#endif

INLINED void test_leaf(nearest_t *nearest, const global block_t *blocks, const int leaf)
{
#if HAS_SPHERES
    if (nearest->kind != KIND_TRIANGLES) {
        test_spheres(nearest, (const global sphere_block_t *)blocks + leaf);
        return;
    }
#endif
    for (int block = leaf; block != NO_BLOCK; block = next_block(leaf_at(blocks, block), block)) {
        test_triangles(nearest, leaf_at(blocks, block));
    }
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
