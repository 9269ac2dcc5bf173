// Triangle blocks of WIDTH triangles, one per lane: plain edge functions reject most of them together, and the exact
// test takes the others one by one.
//
// IS_GPU, if defined as 1: the vector unit of the device works across work-items. Vectors of corners would only take
// registers, and the choice of one lane would put them into slow memory, so that triangles are loaded one by one.

// keep: leaves of one layout
#include "math/lanes.cl"
#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "triangles/triangle.cl"

// A leaf has no more blocks.
#define NO_BLOCK -1

#if HAS_SHARED_VERTICES
#include "triangles/shared.cl"
#else
#include "triangles/stored.cl"
#endif

// One bit for each lane to test.
INLINED uint lanes_in(const leaf_t leaf)
{
    return (1u << lane_count(leaf)) - 1;
}

// A triangle's index is WIDTH * block + lane, in 32 bits without a sign.
INLINED int triangle_index_of(const int block, const int lane)
{
    return (int)(WIDTH * (uint)block + lane);
}

INLINED corners_t corners_at(const global block_t *blocks, const int triangle_index)
{
    const leaf_t leaf = leaf_at(blocks, (uint)triangle_index / WIDTH);
    const uint lane = (uint)triangle_index % WIDTH;
    const corners_t corners = {corner_of(leaf, 0, lane), corner_of(leaf, 1, lane), corner_of(leaf, 2, lane)};
    return corners;
}

// The axis permutation of a ray, the same for every block: `axes` are those that become x, y and z, see permute_axes.
typedef struct {
    int axes[3];
    float3 origin;
#if EXACT
    float reach;  // see reach_of
#endif
} axis_permutation_t;

INLINED axis_permutation_t make_axis_permutation(const ray_t *ray)
{
    axis_permutation_t permutation;
    permutation.axes[0] = ray->axis == 2 ? 0 : ray->axis + 1;
    permutation.axes[1] = ray->axis == 0 ? 2 : ray->axis - 1;
    permutation.axes[2] = ray->axis;
    permutation.origin = permute_axes(ray->origin, ray->axis);
#if EXACT
    permutation.reach = reach_of(ray);
#endif
    return permutation;
}

#if IS_GPU

INLINED void intersect_block(
    const global block_t *blocks, const int block, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    const leaf_t leaf = leaf_at(blocks, block);
    for (int lane = 0; lane < lane_count(leaf); lane++) {
        const int triangle_index = triangle_index_of(block, lane);
        const corners_t corners = corners_at(blocks, triangle_index);
        intersect_corners(&corners, prim_id_of(leaf, lane), triangle_index, ray, search, query);
    }
}

#else

// Sheared vertices as of shear_vertex, one per lane; z is not yet scaled to units of t.
typedef struct {
    lanes_t x;
    lanes_t y;
    lanes_t z;
} vertices_t;

INLINED vertices_t shear_lanes(
    const leaf_t leaf, const int corner, const ray_t *ray, const axis_permutation_t *permutation)
{
    const lanes_t x = load_row(leaf, corner, permutation->axes[0]) - permutation->origin.x;
    const lanes_t y = load_row(leaf, corner, permutation->axes[1]) - permutation->origin.y;
    const lanes_t z = load_row(leaf, corner, permutation->axes[2]) - permutation->origin.z;
    const vertices_t vertices = {x - ray->shear.x * z, y - ray->shear.y * z, z};
    return vertices;
}

#if EXACT

INLINED lanes_t lane_sizes(const lanes_t numbers)
{
    return larger_lanes(numbers, -numbers);
}

// The largest coordinate of a vertex across the ray.
INLINED lanes_t widest(const vertices_t *vertices)
{
    return larger_lanes(lane_sizes(vertices->x), lane_sizes(vertices->y));
}

INLINED float3 length_of_lane(const float vertices[3][WIDTH], const int lane)
{
    return (float3)(vertices[0][lane], vertices[1][lane], vertices[2][lane]);
}

#endif

INLINED float3 vertex_of_lane(const float vertices[3][WIDTH], const int lane, const ray_t *ray)
{
    return (float3)(vertices[0][lane], vertices[1][lane], ray->shear.z * vertices[2][lane]);
}

INLINED void intersect_block(
    const global block_t *blocks, const int block, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    const leaf_t leaf = leaf_at(blocks, block);
    const vertices_t a = shear_lanes(leaf, 0, ray, permutation);
    const vertices_t b = shear_lanes(leaf, 1, ray, permutation);
    const vertices_t c = shear_lanes(leaf, 2, ray, permutation);

    // As in intersect_corners. NaN fails both comparisons.
    const lanes_t edge_a = c.x * b.y - c.y * b.x;
    const lanes_t edge_b = a.x * c.y - a.y * c.x;
    const lanes_t edge_c = b.x * a.y - b.y * a.x;
    const lanes_t min_edge = smaller_lanes(smaller_lanes(edge_a, edge_b), edge_c);
    const lanes_t max_edge = larger_lanes(larger_lanes(edge_a, edge_b), edge_c);
#if EXACT
    const lanes_t wide = larger_lanes(larger_lanes(widest(&a), widest(&b)), widest(&c));
    const lanes_t far = larger_lanes(larger_lanes(lane_sizes(a.z), lane_sizes(b.z)), lane_sizes(c.z));
    const lanes_t error = EDGE_ERROR(CORNER_ERROR(permutation->reach, far, wide), wide);
    uint left = mask_bits((min_edge >= -error) | (max_edge <= error)) & lanes_in(leaf);
#else
    uint left = mask_bits((min_edge >= 0.0f) | (max_edge <= 0.0f)) & lanes_in(leaf);
#endif
    if (left == 0) {
        return;
    }

    union {
        vertices_t lanes[3];
        float vertices[3][3][WIDTH];
    } sheared = {{a, b, c}};
    do {
        const int lane = lowest_bit(left);
        left &= left - 1;
#if EXACT
        decide_triangle(
            length_of_lane(sheared.vertices[0], lane), length_of_lane(sheared.vertices[1], lane),
            length_of_lane(sheared.vertices[2], lane), permutation->reach, prim_id_of(leaf, lane),
            triangle_index_of(block, lane), ray, search, query);
#else
        intersect_sheared(
            vertex_of_lane(sheared.vertices[0], lane, ray), vertex_of_lane(sheared.vertices[1], lane, ray),
            vertex_of_lane(sheared.vertices[2], lane, ray), prim_id_of(leaf, lane), triangle_index_of(block, lane), ray,
            search, query);
#endif
    } while (left != 0);
}

#endif

// Tests all blocks of a leaf.
INLINED void intersect_triangles(
    const global block_t *blocks, const int leaf, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    for (int block = leaf; block != NO_BLOCK; block = next_block(leaf_at(blocks, block), block)) {
        COUNT(search, prim_tests, triangles_in(leaf_at(blocks, block)));
        intersect_block(blocks, block, ray, permutation, search, query);
    }
}

// One corner of each triangle in the coordinates whose zero is the point.
INLINED point_t place_corners(const nearest_t *nearest, const leaf_t leaf, const int corner)
{
    return place_point(
        &nearest->metric, load_row(leaf, corner, 0), load_row(leaf, corner, 1), load_row(leaf, corner, 2));
}

// Degenerate triangles are NaN, which is never near.
INLINED void test_block(nearest_t *nearest, const leaf_t leaf)
{
    distances_t upper;
    const distances_t squared = {squared_to_triangle(
        nearest, place_corners(nearest, leaf, 0), place_corners(nearest, leaf, 1),
        place_corners(nearest, leaf, 2), &upper.lanes)};
    uint near = mask_bits(squared.lanes <= nearest->distance_squared) & lanes_in(leaf);
    for (; near != 0; near &= near - 1) {
        const int lane = lowest_bit(near);
        add_distance(nearest, squared.of_lane[lane], upper.of_lane[lane], prim_id_of(leaf, lane));
    }
}

INLINED void test_triangles(nearest_t *nearest, const global block_t *blocks, const int leaf)
{
    for (int block = leaf; block != NO_BLOCK; block = next_block(leaf_at(blocks, block), block)) {
        test_block(nearest, leaf_at(blocks, block));
    }
}
