// The distance of a point from a single primitive, in the layouts whose blocks are one primitive.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "triangles/single.cl"
#if HAS_SPHERES
#include "nearest/point_sphere.cl"
#if !LONE
#include "nearest/placed_sphere.cl"
#endif
#endif

// A corner or a centre in the coordinates whose zero is the point.
INLINED point_t relative_corner(const nearest_t *nearest, const float3 corner)
{
#if !LONE
    return place_point(&nearest->metric, corner.x, corner.y, corner.z);
#else
    const float3 moved = corner - nearest->point;
    const point_t result = {moved.x, moved.y, moved.z};
    return result;
#endif
}

INLINED void test_triangle(nearest_t *nearest, const global block_t *blocks, const int triangle_index)
{
    const corners_t corners = corners_at(blocks, triangle_index);
    // A degenerate triangle, stored with three equal corners, is never the nearest.
    if (all(corners.a == corners.b) && all(corners.a == corners.c)) {
        return;
    }
    const float squared = distance_squared_to_triangle(
        relative_corner(nearest, corners.a), relative_corner(nearest, corners.b), relative_corner(nearest, corners.c));
    add_distance(nearest, squared, blocks[triangle_index].prim_id);
}

#if HAS_SPHERES
INLINED void test_sphere(nearest_t *nearest, const global sphere_block_t *sphere)
{
#if !LONE
    const point_t centre = {sphere->centre[0], sphere->centre[1], sphere->centre[2]};
    const float squared = distance_squared_to_placed_sphere(nearest, centre, sphere->radius);
#else
    const float squared = distance_squared_to_sphere(relative_corner(nearest, load3(sphere->centre)), sphere->radius);
#endif
    add_distance(nearest, squared, sphere->prim_id);
}
#endif

INLINED void test_single(nearest_t *nearest, const global block_t *blocks, const int prim_index)
{
#if HAS_SPHERES
    if (nearest->kind != KIND_TRIANGLES) {
        test_sphere(nearest, (const global sphere_block_t *)blocks + prim_index);
        return;
    }
#endif
    test_triangle(nearest, blocks, prim_index);
}
