// intersect_triangle: ray i against triangle i, after an earlier crossing.
//
// rays[count], triangles[count]
// earlier[count]                   what was nearest before; prim_id NO_PRIM for nothing
// hits[count], places[count]       written; what is nearest after

#include "one_triangle.cl"

kernel void cross_triangles(
    const global ray_t *restrict rays, const global triangle_t *restrict triangles,
    const global hit_t *restrict earlier, global hit_t *restrict hits, global int *restrict places, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    search_t search = begin_search(1, 0);
    const crossing_t before = {earlier[i].t, earlier[i].u, earlier[i].v, earlier[i].prim_id, -1};
    search.nearest = before;
    intersect_triangle(triangles, i, &path, &search, QUERY_CLOSEST);
    hits[i] = as_hit(&search.nearest);
    places[i] = search.nearest.place;
}
