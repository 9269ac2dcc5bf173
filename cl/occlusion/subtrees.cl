// The subtrees that rays from one point to one side of a plane can meet, found once for all rays of the point. All
// rays would visit the nodes from the root down to the point, and test the boxes beside that way again and again; these
// boxes are tested here together, and those behind the plane, or too far away, never.
//
// The subtrees are those of a lone shape, in the layouts with HAS_ENTRY_POINTS, see traversal/traverse.cl. Elsewhere,
// all rays begin at the root.

#include "math/vectors.cl"
#include "traversal/traverse.cl"
#include "world/world.cl"

#if LONE && HAS_ENTRY_POINTS && !EXACT

// Room for the subtrees, in vectors of WIDTH boxes.
#ifndef SUBTREE_GROUPS
#define SUBTREE_GROUPS 8
#endif
#define MOST_SUBTREES (SUBTREE_GROUPS * WIDTH)

// Boxes that are this far away from the half-space, in shares of the reach, are left out: more than all that rounding
// can do to rays and triangles, for which docs/internals/padding.md has less than 64 roundings.
#define OUTSIDE_SLACK (256.0f * ROUNDING)

typedef struct {
    union {
        lanes_t of_group[SUBTREE_GROUPS][6];
        float of_lane[SUBTREE_GROUPS][6][WIDTH];
    } planes;                  // minima along x, y and z, then maxima, as in a node
    int child[MOST_SUBTREES];  // as in a node: a node or a block
    int count;
} subtrees_t;

// Copies a child of a node, or an inverted box for no node, to the end.
INLINED void append_subtree(subtrees_t *subtrees, const global node_t *node, const int lane)
{
    const int slot = subtrees->count++;
    for (int axis = 0; axis < 3; axis++) {
        float *const lower = subtrees->planes.of_lane[slot / WIDTH][axis];
        float *const upper = subtrees->planes.of_lane[slot / WIDTH][axis + 3];
        lower[slot % WIDTH] = node ? node->aabb_min[axis][lane] : FLT_MAX;
        upper[slot % WIDTH] = node ? node->aabb_max[axis][lane] : -FLT_MAX;
    }
    subtrees->child[slot] = node ? node->child[lane] : 0;
}

// Finds the subtrees for rays from a position to the side of a unit normal, up to a length of t_max.
INLINED void find_subtrees(
    const world_t *world, const float3 position, const float3 normal, const float t_max, subtrees_t *subtrees)
{
    const float3 size = magnitude(position);
    const float slack = OUTSIDE_SLACK * (1.0f + size.x + size.y + size.z);
    const float limit = t_max + slack;
    // Nodes whose boxes contain the position, and which are replaced by their children as long as there is room.
    int around[SUBTREE_GROUPS];
    int around_count = 1;
    around[0] = 0;
    subtrees->count = 0;

    while (around_count > 0) {
        const global node_t *node = world->nodes + around[--around_count];
        for (int lane = 0; lane < WIDTH; lane++) {
            const float3 lower =
                (float3)(node->aabb_min[0][lane], node->aabb_min[1][lane], node->aabb_min[2][lane]) - position;
            const float3 upper =
                (float3)(node->aabb_max[0][lane], node->aabb_max[1][lane], node->aabb_max[2][lane]) - position;
            const float3 highest = normal > 0.0f ? upper : lower;
            const float3 outside = max(max(lower, -upper), 0.0f);
            // Missing children have inverted boxes.
            if (lower.x > upper.x || dot_product(highest, normal) < -slack
                || dot_product(outside, outside) > limit * limit) {
                continue;
            }
            const bool is_around = outside.x + outside.y + outside.z == 0.0f;
            const int most = subtrees->count + WIDTH * (around_count + 2);
            if (is_around && node->child[lane] >= 0 && most <= MOST_SUBTREES) {
                around[around_count++] = node->child[lane];
            } else {
                append_subtree(subtrees, node, lane);
            }
        }
    }
    while (subtrees->count % WIDTH != 0) {
        append_subtree(subtrees, 0, 0);
    }
}

// Whether a ray from the position into the half-space meets anything.
INLINED bool meets_subtrees(const world_t *world, const subtrees_t *subtrees, const world_ray_t *ray)
{
    const slabs_t slabs = make_slabs(ray);
    const axis_permutation_t permutation = make_axis_permutation(ray);
    search_t search = make_search(1, 0);
    const int3 near_plane = slabs.near_offset / WIDTH;
    const int3 far_plane = slabs.far_offset / WIDTH;
    // Those near the position come last, and are tested first.
    for (int group = subtrees->count / WIDTH - 1; group >= 0; group--) {
        const lanes_t *planes = subtrees->planes.of_group[group];
        const planes_t loaded = {
            {planes[near_plane.x], planes[near_plane.y], planes[near_plane.z]},
            {planes[far_plane.x], planes[far_plane.y], planes[far_plane.z]}};
        lanes_t t_near;
        uint met = meets_planes(&loaded, &slabs, ray->t_max * slabs.unit, &t_near);
        for (; met != 0; met &= met - 1) {
            const int child = subtrees->child[WIDTH * group + lowest_bit(met)];
            if (child < 0) {
                intersect_leaf(world->blocks.own, ~child, ray, &permutation, &search, QUERY_COUNT);
            } else {
                visit_as_stored(
                    world->nodes, world->nodes + child, world->blocks.own, ray, &slabs, &permutation, &search,
                    QUERY_COUNT);
            }
            if (is_complete(&search, QUERY_COUNT)) {
                return true;
            }
        }
    }
    return false;
}

#else

typedef struct {
    int count;  // no subtree but the tree
} subtrees_t;

INLINED void find_subtrees(
    const world_t *world, const float3 position, const float3 normal, const float t_max, subtrees_t *subtrees)
{
    subtrees->count = 0;
}

INLINED bool meets_subtrees(const world_t *world, const subtrees_t *subtrees, const world_ray_t *ray)
{
    return meets_anything(world, ray);
}

#endif
