// The distance of a point from a single primitive, in the layouts whose blocks are one primitive.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "triangles/single.cl"
#if HAS_SPHERES
#include "nearest/sphere.cl"
#endif

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
        &nearest->metric, place_corner(nearest, corners.a), place_corner(nearest, corners.b),
        place_corner(nearest, corners.c), &upper);
    add_distance(nearest, squared, upper, blocks[triangle_index].prim_id);
}

INLINED void test_single(nearest_t *nearest, const global block_t *blocks, const int prim_index)
{
#if HAS_SPHERES
    if (nearest->kind != KIND_TRIANGLES) {
        const global sphere_block_t *sphere = (const global sphere_block_t *)blocks + prim_index;
        const point_t centre = {sphere->centre[0], sphere->centre[1], sphere->centre[2]};
        add_distance(nearest, distance_squared_to_sphere(nearest, centre, sphere->radius), INFINITY, sphere->prim_id);
        return;
    }
#endif
    test_triangle(nearest, blocks, prim_index);
}
