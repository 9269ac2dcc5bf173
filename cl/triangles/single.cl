// Triangle blocks of a single triangle.

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
