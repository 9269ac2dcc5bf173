// Blocks of WIDTH spheres, one per lane: the discriminant rejects most of them together, and the exact test takes the
// others one by one.

#include "math/lanes.cl"
#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "spheres/distance.cl"
#include "spheres/sphere.cl"
#include "triangles/block.cl"

#if WIDTH == 8
typedef sphere8_t sphere_block_t;
#else
typedef sphere4_t sphere_block_t;
#endif

INLINED ball_t ball_at(const global sphere_block_t *blocks, const int sphere_index)
{
    const global sphere_block_t *block = blocks + (uint)sphere_index / WIDTH;
    const uint lane = (uint)sphere_index % WIDTH;
    const ball_t ball = {
        (float3)(block->centre[0][lane], block->centre[1][lane], block->centre[2][lane]), block->radius[lane]};
    return ball;
}

// The lanes do not scale to the radius, so their squares may underflow by less than this, where those of
// intersect_sheared_origin do not. Otherwise both discriminants have the same sign.
#define LOST_BY_UNDERFLOW 0x1p-120f

// A sphere's index is WIDTH * block + lane.
INLINED void intersect_spheres(
    const global sphere_block_t *blocks, const int block, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    // As in shear_origin.
    const global sphere_block_t *spheres = blocks + block;
    COUNT(search, prim_tests, count_prims(spheres->prim_id));
    const lanes_t z = permutation->origin.z - load_lanes(spheres->centre[permutation->axes[2]]);
    const lanes_t x = permutation->origin.x - load_lanes(spheres->centre[permutation->axes[0]]) - ray->shear.x * z;
    const lanes_t y = permutation->origin.y - load_lanes(spheres->centre[permutation->axes[1]]) - ray->shear.y * z;
    const lanes_t radius = load_lanes(spheres->radius);

    // As in intersect_sheared_origin. Lanes without a sphere are NaN, which fails the comparison.
    const lanes_t twist = x * ray->shear.y - y * ray->shear.x;
#if EXACT
    const lanes_t wide = larger_lanes(lane_sizes(x), lane_sizes(y));
    const lanes_t most = radius + 8.0f * CORNER_ERROR(permutation->reach, lane_sizes(z), wide + radius);
#else
    const lanes_t most = radius;
#endif
    const lanes_t farthest = slope_squared(ray) * (most * most) + LOST_BY_UNDERFLOW;
    uint left = mask_bits(x * x + y * y + twist * twist <= farthest);
    if (left == 0) {
        return;
    }

    union {
        lanes_t lanes[3];
        float of_lane[3][WIDTH];
    } sheared = {{x, y, z}};
    do {
        const int lane = lowest_bit(left);
        left &= left - 1;
        const float3 origin = (float3)(sheared.of_lane[0][lane], sheared.of_lane[1][lane], sheared.of_lane[2][lane]);
        intersect_sheared_origin(
            origin, spheres->radius[lane], spheres->prim_id[lane], WIDTH * block + lane, ray, search, query);
    } while (left != 0);
}

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
