// What a kind does with the primitives of a leaf in the layouts `bvh4`, `bvh8` and `bvh8c`. Each kind has the same
// functions in a folder of its own, such as triangles/block.cl.

#include "spheres/block.cl"
#include "triangles/block.cl"

// The test of a ray.
INLINED void intersect_leaf(
    const global block_t *blocks, const int leaf, const ray_t *ray, const axis_permutation_t *permutation,
    search_t *search, const int query)
{
    COUNT(search, leaf_visits, 1);
    if (IS_SPHERES(search->kind)) {
        intersect_spheres((const global sphere_block_t *)blocks, leaf, ray, permutation, search, query);
    } else {
        intersect_triangles(blocks, leaf, ray, permutation, search, query);
    }
}

// The distances from a point.
INLINED void test_leaf(nearest_t *nearest, const global block_t *blocks, const int leaf)
{
    if (IS_SPHERES(nearest->kind)) {
        test_spheres(nearest, (const global sphere_block_t *)blocks + leaf);
    } else {
        test_triangles(nearest, blocks, leaf);
    }
}
