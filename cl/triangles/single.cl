// Triangle blocks of a single triangle.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "triangles/triangle.cl"

typedef triangle_t block_t;

INLINED corners_t corners_at(const global block_t *blocks, const int triangle_index)
{
    const global triangle_t *triangle = blocks + triangle_index;
    const corners_t corners = {load3(triangle->a), load3(triangle->b), load3(triangle->c)};
    return corners;
}

INLINED void intersect_triangle(
    const global block_t *blocks, const int triangle_index, const ray_t *ray, search_t *search, const int query)
{
    const corners_t corners = corners_at(blocks, triangle_index);
    intersect_corners(&corners, blocks[triangle_index].prim_id, triangle_index, ray, search, query);
}

INLINED point_t place_corner(const nearest_t *nearest, const float3 corner)
{
    return place_point(&nearest->metric, corner.x, corner.y, corner.z);
}

INLINED void test_triangle(nearest_t *nearest, const global block_t *blocks, const int triangle_index)
{
    const corners_t corners = corners_at(blocks, triangle_index);
    // A degenerate triangle is never the nearest.
    if (isnan(corners.a.x)) {
        return;
    }
    float upper;
    const float squared = squared_to_triangle(
        nearest, place_corner(nearest, corners.a), place_corner(nearest, corners.b),
        place_corner(nearest, corners.c), &upper);
    add_distance(nearest, squared, upper, blocks[triangle_index].prim_id);
}
