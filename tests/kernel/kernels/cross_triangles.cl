// intersect_triangle: ray i against triangle i, after an earlier crossing.
//
// rays[count], triangles[count]
// earlier[count]                   what was nearest before; prim_id NO_PRIM for nothing
// hits[count], triangle_indices[count]       written; what is nearest after

#include "triangles/single.cl"

kernel void cross_triangles(
    const global packed_ray_t *restrict rays, const global triangle_t *restrict triangles,
    const global hit_t *restrict earlier, global hit_t *restrict hits, global int *restrict triangle_indices,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    search_t search = make_search(1, 0);
    const crossing_t before = {earlier[i].t, earlier[i].u, earlier[i].v, earlier[i].prim_id, -1};
    search.nearest = before;
    intersect_triangle(triangles, i, &ray, &search, QUERY_CLOSEST);
    hits[i] = as_hit(&search.nearest);
    triangle_indices[i] = search.nearest.triangle_index;
}
