// no_crossing, is_found, as_hit and search_limit.
//
// rays[count], earlier[count]       a ray and the nearest crossing so far
// none[count], hits[count]          written; no_crossing and the crossing, as hits
// is_found_yet[count]               written; whether no_crossing counts as found, plus 2 if the crossing does
// limits[count]                     written; how far the search goes on

#include "hits/search.cl"

kernel void keep_crossing(
    const global packed_ray_t *restrict rays, const global hit_t *restrict earlier, global hit_t *restrict none,
    global hit_t *restrict hits, global int *restrict is_found_yet, global float *restrict limits, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    const crossing_t nothing = no_crossing();
    const crossing_t nearest = {earlier[i].t, earlier[i].u, earlier[i].v, earlier[i].prim_id, 7};
    none[i] = as_hit(&nothing);
    hits[i] = as_hit(&nearest);
    is_found_yet[i] = (is_found(&nothing) ? 1 : 0) + (is_found(&nearest) ? 2 : 0);
    search_t search = make_search(1, 0);
    search.nearest = nearest;
    limits[i] = search_limit(&search, &ray, QUERY_CLOSEST);
}
