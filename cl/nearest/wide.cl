// Nearest triangle in the `bvh4` and `bvh8` layouts: depth first, the nearest child first. A waiting child is held
// against the nearest triangle again when its turn comes.
//
// Assumes STACK_SIZE >= the number of children that can wait, at least 1.

#include "nearest_search.cl"
#include "traverse_wide.cl"

// The slack of may_be_nearer, and two more roundings: of the root, and of taking the slack off.
#define NEAREST_SLACK_OF_LANES ERROR_BOUND(18)

// Returns how far outside a box the point is along one axis; *farthest grows by the distance of the farther side.
INLINED lanes_t outside_of(
    const global float *aabb_min, const global float *aabb_max, const float scale, const float point, lanes_t *farthest)
{
    const lanes_t below = scale * load_lanes(aabb_min) - point;
    const lanes_t above = scale * load_lanes(aabb_max) - point;
    *farthest += larger_lanes(larger_lanes(below, -below), larger_lanes(above, -above));
    return larger_lanes(larger_lanes(below, -above), (lanes_t)(0.0f));
}

// Returns a bit for each child that may have something as near as the nearest so far; *entry is the least distance that
// something in it can have.
INLINED uint children_may_be_nearer(const global node_t *node, const nearest_t *nearest, lanes_t *entry)
{
    lanes_t farthest = (lanes_t)(0.0f);
    const float3 point = nearest->point;
    const float scale = nearest->scale;
    const lanes_t x = outside_of(node->aabb_min[0], node->aabb_max[0], scale, point.x, &farthest);
    const lanes_t y = outside_of(node->aabb_min[1], node->aabb_max[1], scale, point.y, &farthest);
    const lanes_t z = outside_of(node->aabb_min[2], node->aabb_max[2], scale, point.z, &farthest);
    *entry = larger_lanes(sqrt(x * x + y * y + z * z) - NEAREST_SLACK_OF_LANES * farthest, (lanes_t)(0.0f));
    // A box that is inside out is infinitely far away, or as far as numbers go.
    return mask_bits((*entry <= nearest->distance) & (load_lanes(node->aabb_min[0]) <= load_lanes(node->aabb_max[0])));
}

INLINED point_t corners_seen(const nearest_t *nearest, const global group_t *group, const int corner)
{
    const float scale = nearest->scale;
    const point_t result = {
        scale * load_lanes(group->corners[corner][0]) - nearest->point.x,
        scale * load_lanes(group->corners[corner][1]) - nearest->point.y,
        scale * load_lanes(group->corners[corner][2]) - nearest->point.z};
    return result;
}

// The lanes of no triangle, and of degenerate ones, are NaN, and never near.
INLINED void note_group(nearest_t *nearest, const global group_t *group)
{
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } squared = {distance_squared_to_triangle(
        corners_seen(nearest, group, 0), corners_seen(nearest, group, 1), corners_seen(nearest, group, 2))};
    for (uint near = mask_bits(squared.lanes <= nearest->distance_squared); near != 0; near &= near - 1) {
        const int lane = lowest_bit(near);
        note_distance(nearest, squared.of_lane[lane], group->prim_id[lane]);
    }
}

INLINED void visit_nearest(
    const global node_t *nodes, const global group_t *groups, const int group_count, nearest_t *nearest)
{
    ulong stack[STACK_SIZE];
    int waiting = 0;
    int next = 0;

    while (true) {
        if (next >= 0) {
            const global node_t *node = nodes + next;
            lanes_t entry;
            const uint near = children_may_be_nearer(node, nearest, &entry);
            if (near != 0) {
                const bool is_one = (near & (near - 1)) == 0;
                next = is_one ? node->child[lowest_bit(near)]
                              : stack_children(node->child, near, entry, stack, &waiting);
                continue;
            }
        } else {
            note_group(nearest, groups + ~next);
        }
        ulong popped;
        do {
            if (waiting == 0) {
                return;
            }
            popped = stack[--waiting];
        } while (entry_of(popped) > nearest->distance);
        next = child_of(popped);
    }
}
