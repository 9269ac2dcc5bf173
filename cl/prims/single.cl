// What a kind does with a primitive in the layouts whose blocks are one primitive. Each kind has the same functions in
// a folder of its own, such as triangles/single.cl.

#include "spheres/single.cl"
#include "triangles/single.cl"

// The test of a ray.
INLINED void intersect_single(
    const global block_t *blocks, const int prim_index, const ray_t *ray, search_t *search, const int query)
{
    COUNT(search, prim_tests, 1);
    if (IS_SPHERES(search->kind)) {
        intersect_sphere((const global sphere_block_t *)blocks, prim_index, ray, search, query);
    } else {
        intersect_triangle(blocks, prim_index, ray, search, query);
    }
}

// The distance from a point.
INLINED void test_single(nearest_t *nearest, const global block_t *blocks, const int prim_index)
{
    if (IS_SPHERES(nearest->kind)) {
        test_sphere(nearest, (const global sphere_block_t *)blocks + prim_index);
    } else {
        test_triangle(nearest, blocks, prim_index);
    }
}
