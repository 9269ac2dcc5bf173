// intersect_sphere: ray i against sphere i.
//
// rays[count], spheres[count]
// hits[2 * count]     written: the crossings along the ray, in order; a miss follows if there are fewer than two
// closest[count]      written: what is nearest
// counts[count]       written: the number of crossings

#include "spheres/single.cl"

kernel void cross_spheres(
    const global packed_ray_t *restrict rays, const global sphere_t *restrict spheres, global hit_t *restrict hits,
    global hit_t *restrict closest, global int *restrict counts, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    search_t first = make_search(2, hits + 2 * i);
    intersect_sphere(spheres, i, &ray, &first, QUERY_FIRST);
    sort_hits(&first);
    for (int slot = first.count; slot < 2; slot++) {
        const crossing_t none = no_crossing();
        hits[2 * i + slot] = as_hit(&none);
    }
    search_t nearest = make_search(1, 0);
    intersect_sphere(spheres, i, &ray, &nearest, QUERY_CLOSEST);
    closest[i] = as_hit(&nearest.nearest);
    search_t all = make_search(INT_MAX, 0);
    intersect_sphere(spheres, i, &ray, &all, QUERY_COUNT);
    counts[i] = all.count;
}
