// Finds where the rays of a tile begin in a scene, from the bounds of its rays; see instances/start.cl.
//
// Entry points exist in the layouts with HAS_ENTRY_POINTS, see traversal/traverse.cl.

// keep: expanded before the branch
#include "instances/instance.cl"
#include "instances/start.cl"
#include "traversal/entry_point.cl"

#if HAS_ENTRY_POINTS

// The roundings of a ray on its way into an instance and of its bounds, relative to the coordinates of its origin and
// of the instance, and to its direction: docs/internals/scenes.md counts them.
#define ENTERING_SLACK ERROR_BOUND(32)
#define TURNING_SLACK ERROR_BOUND(16)

INLINED float3 larger_magnitude(const float3 a, const float3 b)
{
    return fmax(magnitude(a), magnitude(b));
}

// Bounds all products of a matrix and a vector between two others.
INLINED void bound_transformed(
    const global float rows[3][3], const float3 lower, const float3 upper, const float3 slack, float3 *lowest,
    float3 *highest)
{
    const float3 middle = transform_vector(rows, 0.5f * lower + 0.5f * upper);
    const float3 half_size = 0.5f * upper - 0.5f * lower + slack;
    const float3 reach = (float3)(
        dot_product(magnitude(load3(rows[0])), half_size), dot_product(magnitude(load3(rows[1])), half_size),
        dot_product(magnitude(load3(rows[2])), half_size));
    *lowest = middle - reach;
    *highest = middle + reach;
}

// Writes bounds of the rays in an instance's geometry, as enter_instance computes them. Returns false if some of the
// rays may be advanced: then their bounds are not known.
INLINED bool bound_inside(
    const global instance_t *instance, const ray_bounds_t *outside, ray_bounds_t *inside)
{
    const float3 centre = load3(instance->centre);
    const float3 lower = outside->lower.s012 - centre;
    const float3 upper = outside->upper.s012 - centre;
    const float3 reach = larger_magnitude(outside->lower.s012, outside->upper.s012) + magnitude(centre);
    const float3 slack = ENTERING_SLACK * reach;
    if (!(largest_component(larger_magnitude(lower, upper) + slack) <= FAR_RADII * instance->radius)) {
        return false;
    }
    float3 lowest, highest, lowest_direction, highest_direction;
    bound_transformed(instance->to_object, lower, upper, slack, &lowest, &highest);
    const float3 speed = larger_magnitude(outside->lower.s456, outside->upper.s456);
    bound_transformed(
        instance->to_object, outside->lower.s456, outside->upper.s456, TURNING_SLACK * speed,
        &lowest_direction, &highest_direction);
    inside->lower = (float8)(lowest, outside->lower.s3, lowest_direction, outside->lower.s7);
    inside->upper = (float8)(highest, outside->upper.s3, highest_direction, outside->upper.s7);
    return true;
}

// Inserts a leaf into the list of a tile, which is in the order of t_near. Assumes that there is room.
INLINED void list_leaf(global tile_t *tile, const int count, const int slot, const float t_near)
{
    int index = count;
    for (; index > 0 && tile->t_near[index - 1] > t_near; index--) {
        tile->leaf[index] = tile->leaf[index - 1];
        tile->t_near[index] = tile->t_near[index - 1];
    }
    tile->leaf[index] = slot;
    tile->t_near[index] = t_near;
}

// Lists the leaves that a beam meets. If they are too many, rays begin at the deepest node that has all of them.
INLINED void list_leaves(const global bvh2_node_t *top_nodes, const beam_t *beam, global tile_t *tile)
{
    int stack[TOP_STACK_SIZE];
    int stack_count = 0;
    int node = 0;
    int leaf_count = 0;
    bool is_only = true;  // nothing but this node and what is below it is met
    tile->top_node = 0;
    while (true) {
        if (is_only) {
            tile->top_node = node;
        }
        int next = NO_CHILD;
        int met_count = 0;
        for (int child = 0; child < 2; child++) {
            const global bvh2_node_t *parent = top_nodes + node;
            const float3 aabb_min = load3(parent->aabb_min[child]), aabb_max = load3(parent->aabb_max[child]);
            float t_near;
            if (!beam_meets_aabb(aabb_min, aabb_max, beam, &t_near)) {
                continue;
            }
            met_count++;
            if (parent->count[child] == 0) {
                if (next != NO_CHILD) {
                    stack[stack_count++] = next;
                }
                next = parent->first[child];
            } else if (leaf_count == MAX_TILE_LEAVES) {
                tile->leaf_count = NO_LIST;
                return;
            } else {
                list_leaf(tile, leaf_count++, 2 * node + child, t_near);
            }
        }
        is_only = is_only && met_count == 1;
        if (next == NO_CHILD) {
            if (stack_count == 0) {
                tile->leaf_count = leaf_count;
                return;
            }
            next = stack[--stack_count];
        }
        node = next;
    }
}

// Lets the rays of a tile begin at the root.
INLINED void skip_tile(global tile_t *tile)
{
    tile->instance_index = NO_INSTANCE;
    tile->top_node = 0;
    tile->leaf_count = NO_LIST;
}

// Finds where the rays of a tile begin, from their bounds and the bits of all their masks.
INLINED void find_tile(
    const global bvh2_node_t *top_nodes, const global instance_t *instances, const global node_t *nodes,
    const ray_bounds_t *bounds, const uint mask, global tile_t *tile, global node_t *entry_point)
{
    const beam_t beam = make_beam(bounds);
    skip_tile(tile);
    if (beam.is_empty) {
        tile->leaf_count = 0;
    }
    if (beam.is_empty || beam.is_unbounded) {
        return;
    }
    list_leaves(top_nodes, &beam, tile);
    if (tile->leaf_count != 1) {
        return;
    }
    const int leaf = tile->leaf[0];
    if (top_nodes[leaf >> 1].count[leaf & 1] != 1) {
        return;
    }
    const int index = top_nodes[leaf >> 1].first[leaf & 1];
    const global instance_t *instance = instances + index;
    ray_bounds_t inside;
    if ((instance->mask & mask) == 0) {
        tile->leaf_count = 0;
    } else if (bound_inside(instance, bounds, &inside)) {
        const global node_t *root = nodes + instance->first_node;
        find_entry_point(root, &inside, entry_point);
        if (entry_point->child[0] == ROOT) {
            return;
        }
        // A child may be the block 0, which has the number of no child: its box tells.
        if (has_children(entry_point)) {
            tile->instance_index = index;
        } else {
            tile->leaf_count = 0;
        }
    }
}

#endif
