// Triangle blocks of WIDTH triangles, one per lane: plain edge functions reject most of them together, and the exact
// test takes the others one by one.
//
// IS_GPU, if defined as 1: the vector unit of the device works across work-items. Vectors of corners would only take
// registers, and the choice of one lane would put them into slow memory, so that triangles are loaded one by one.

#include "math/lanes.cl"
#include "triangles/triangle.cl"

// A triangle's index is WIDTH * block + lane.
INLINED corners_t corners_at(const global block_t *blocks, const int triangle_index)
{
    const global block_t *block = blocks + (uint)triangle_index / WIDTH;
    const uint lane = (uint)triangle_index % WIDTH;
    float3 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = (float3)(block->corners[i][0][lane], block->corners[i][1][lane], block->corners[i][2][lane]);
    }
    const corners_t result = {corners[0], corners[1], corners[2]};
    return result;
}

// The axis permutation of a ray, the same for every block: `axes` are those that become x, y and z, see permute_axes.
typedef struct {
    int axes[3];
    float3 origin;
} axis_permutation_t;

INLINED axis_permutation_t make_axis_permutation(const ray_t *ray)
{
    axis_permutation_t permutation;
    permutation.axes[0] = ray->axis == 2 ? 0 : ray->axis + 1;
    permutation.axes[1] = ray->axis == 0 ? 2 : ray->axis - 1;
    permutation.axes[2] = ray->axis;
    permutation.origin = permute_axes(ray->origin, ray->axis);
    return permutation;
}

#if IS_GPU

INLINED void intersect_block(
    const global block_t *blocks, const int block, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    // Lanes without a triangle are NaN, which no ray hits.
    for (int lane = 0; lane < WIDTH; lane++) {
        const int triangle_index = WIDTH * block + lane;
        const corners_t corners = corners_at(blocks, triangle_index);
        intersect_corners(&corners, blocks[block].prim_id[lane], triangle_index, ray, search, query);
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
    const global block_t *block, const int corner, const ray_t *ray, const axis_permutation_t *permutation)
{
    const lanes_t x = load_lanes(block->corners[corner][permutation->axes[0]]) - permutation->origin.x;
    const lanes_t y = load_lanes(block->corners[corner][permutation->axes[1]]) - permutation->origin.y;
    const lanes_t z = load_lanes(block->corners[corner][permutation->axes[2]]) - permutation->origin.z;
    const vertices_t vertices = {x - ray->shear.x * z, y - ray->shear.y * z, z};
    return vertices;
}

INLINED float3 vertex_of_lane(const float vertices[3][WIDTH], const int lane, const ray_t *ray)
{
    return (float3)(vertices[0][lane], vertices[1][lane], ray->shear.z * vertices[2][lane]);
}

INLINED void intersect_block(
    const global block_t *blocks, const int block, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    const vertices_t a = shear_lanes(blocks + block, 0, ray, permutation);
    const vertices_t b = shear_lanes(blocks + block, 1, ray, permutation);
    const vertices_t c = shear_lanes(blocks + block, 2, ray, permutation);

    // As in intersect_corners. Lanes without a triangle are NaN, which fails both comparisons.
    const lanes_t edge_a = c.x * b.y - c.y * b.x;
    const lanes_t edge_b = a.x * c.y - a.y * c.x;
    const lanes_t edge_c = b.x * a.y - b.y * a.x;
    const lanes_t min_edge = smaller_lanes(smaller_lanes(edge_a, edge_b), edge_c);
    const lanes_t max_edge = larger_lanes(larger_lanes(edge_a, edge_b), edge_c);
    uint left = mask_bits((min_edge >= 0.0f) | (max_edge <= 0.0f));
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
        intersect_sheared(
            vertex_of_lane(sheared.vertices[0], lane, ray), vertex_of_lane(sheared.vertices[1], lane, ray),
            vertex_of_lane(sheared.vertices[2], lane, ray), blocks[block].prim_id[lane], WIDTH * block + lane, ray,
            search, query);
    } while (left != 0);
}

#endif
