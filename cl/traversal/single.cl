// The test of a leaf's primitive in the layouts whose blocks are one primitive.
//
// HAS_SPHERES: see hits/search.cl.

#include "triangles/single.cl"
#if HAS_SPHERES
#include "spheres/single.cl"
#endif

INLINED void intersect_single(
    const global block_t *blocks, const int prim_index, const ray_t *ray, search_t *search, const int query)
{
    COUNT(search, prim_tests, 1);
#if HAS_SPHERES
    if (search->kind == KIND_SPHERES) {
        intersect_sphere((const global sphere_block_t *)blocks, prim_index, ray, search, query);
        return;
    }
#endif
    intersect_triangle(blocks, prim_index, ray, search, query);
}
