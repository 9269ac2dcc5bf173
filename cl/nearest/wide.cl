// The primitive nearest to a point in the `bvh4` and `bvh8` layouts: depth first, nearest child first. A popped child
// is compared again, because the nearest distance may have become smaller.
//
// Assumes STACK_SIZE >= the most children on the stack at once, at least 1.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "traversal/wide.cl"
#if HAS_SPHERES
#include "nearest/point_sphere.cl"
#if !LONE
#include "nearest/placed_sphere.cl"
#endif
#endif

// NEAREST_SLACK and two more roundings: of the square root and of the subtraction of the slack.
#define NEAREST_SLACK_OF_LANES ERROR_BOUND(NEAREST_ROUNDINGS + 2)

// Returns the distance from each box along one axis, and adds the distance of its farther plane to *farthest.
INLINED lanes_t distance_along_axis(
    const global float *aabb_min, const global float *aabb_max, const float point, lanes_t *farthest)
{
    const lanes_t below = load_lanes(aabb_min) - point;
    const lanes_t above = load_lanes(aabb_max) - point;
    *farthest += larger_lanes(larger_lanes(below, -below), larger_lanes(above, -above));
    return larger_lanes(larger_lanes(below, -above), (lanes_t)(0.0f));
}

// Returns one bit per child, set where a primitive in its box may be as near as the nearest so far; *distance has the
// least distance that a primitive in each box can have.
INLINED uint children_may_be_nearer(const global node_t *node, const nearest_t *nearest, lanes_t *distance)
{
#if !LONE
    const point_t lower = {
        load_lanes(node->aabb_min[0]), load_lanes(node->aabb_min[1]), load_lanes(node->aabb_min[2])};
    const point_t upper = {
        load_lanes(node->aabb_max[0]), load_lanes(node->aabb_max[1]), load_lanes(node->aabb_max[2])};
    const point_t way = way_to_box(&nearest->metric, lower, upper);
    *distance = larger_lanes(sqrt(dot_of(way, way)) - nearest->metric.slack, (lanes_t)(0.0f));
#else
    lanes_t farthest = (lanes_t)(0.0f);
    const float3 point = nearest->point;
    const lanes_t x = distance_along_axis(node->aabb_min[0], node->aabb_max[0], point.x, &farthest);
    const lanes_t y = distance_along_axis(node->aabb_min[1], node->aabb_max[1], point.y, &farthest);
    const lanes_t z = distance_along_axis(node->aabb_min[2], node->aabb_max[2], point.z, &farthest);
    *distance = larger_lanes(sqrt(x * x + y * y + z * z) - NEAREST_SLACK_OF_LANES * farthest, (lanes_t)(0.0f));
#endif
    // An inverted box has a huge or infinite distance, which the nearest distance may equal.
    const lane_mask_t is_child = load_lanes(node->aabb_min[0]) <= load_lanes(node->aabb_max[0]);
    return mask_bits((*distance <= nearest->distance) & is_child);
}

// One corner of each triangle in the coordinates whose zero is the point.
INLINED point_t relative_corners(const nearest_t *nearest, const global block_t *block, const int corner)
{
#if !LONE
    return place_point(
        &nearest->metric, load_lanes(block->corners[corner][0]), load_lanes(block->corners[corner][1]),
        load_lanes(block->corners[corner][2]));
#else
    const point_t result = {
        load_lanes(block->corners[corner][0]) - nearest->point.x,
        load_lanes(block->corners[corner][1]) - nearest->point.y,
        load_lanes(block->corners[corner][2]) - nearest->point.z};
    return result;
#endif
}

// Takes the squared distances of a block into account. NaN is never near.
INLINED void add_distances(nearest_t *nearest, const lanes_t distance_squared, const global int *prim_id)
{
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } squared = {distance_squared};
    for (uint near = mask_bits(squared.lanes <= nearest->distance_squared); near != 0; near &= near - 1) {
        const int lane = lowest_bit(near);
        add_distance(nearest, squared.of_lane[lane], prim_id[lane]);
    }
}

// Lanes without a primitive and lanes of degenerate triangles are NaN.
INLINED void test_block(nearest_t *nearest, const global block_t *blocks, const int block_index)
{
#if HAS_SPHERES
    if (nearest->kind != KIND_TRIANGLES) {
        const global sphere_block_t *spheres = (const global sphere_block_t *)blocks + block_index;
#if !LONE
        const point_t centres = {
            load_lanes(spheres->centre[0]), load_lanes(spheres->centre[1]), load_lanes(spheres->centre[2])};
        const lanes_t squared = distance_squared_to_placed_sphere(nearest, centres, load_lanes(spheres->radius));
#else
        const point_t centres = {
            load_lanes(spheres->centre[0]) - nearest->point.x, load_lanes(spheres->centre[1]) - nearest->point.y,
            load_lanes(spheres->centre[2]) - nearest->point.z};
        const lanes_t squared = distance_squared_to_sphere(centres, load_lanes(spheres->radius));
#endif
        add_distances(nearest, squared, spheres->prim_id);
        return;
    }
#endif
    const global block_t *block = blocks + block_index;
    const lanes_t squared = distance_squared_to_triangle(
        relative_corners(nearest, block, 0), relative_corners(nearest, block, 1), relative_corners(nearest, block, 2));
    add_distances(nearest, squared, block->prim_id);
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
            test_block(nearest, blocks, ~next);
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
