// traverse and find_nearest over a tree of spheres.
//
// rays[count]                 also the points: their origins
// nodes[], spheres[]          the tree in a layout, or all spheres without one
// sphere_counts[count]        the number of spheres
// closest[count]              written
// counts[count]               written: the number of crossings
// hits[SLOTS * count]         written: the first crossings along each ray; a miss follows if there are fewer
// prim_ids[count]             written: the sphere whose surface is nearest to each ray's origin

#include "nearest/nearest.cl"
#include "traversal/traverse.cl"

#define SLOTS 6

kernel void trace_spheres(
    const global packed_ray_t *restrict rays, const global node_t *restrict nodes,
    const global sphere_t *restrict spheres, const global int *restrict sphere_counts, global hit_t *restrict closest,
    global int *restrict counts, global hit_t *restrict hits, global int *restrict prim_ids, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    const global block_t *blocks = (const global block_t *)spheres;
    search_t nearest_crossing = make_search(1, 0);
    nearest_crossing.kind = KIND_SPHERES;
    traverse(nodes, nodes, blocks, sphere_counts[i], &ray, &nearest_crossing, QUERY_CLOSEST);
    closest[i] = as_hit(&nearest_crossing.nearest);

    search_t all = make_search(INT_MAX, 0);
    all.kind = KIND_SPHERES;
    traverse(nodes, nodes, blocks, sphere_counts[i], &ray, &all, QUERY_COUNT);
    counts[i] = all.count;

    search_t first = make_search(SLOTS, hits + SLOTS * i);
    first.kind = KIND_SPHERES;
    traverse(nodes, nodes, blocks, sphere_counts[i], &ray, &first, QUERY_FIRST);
    sort_hits(&first);
    for (int slot = first.count; slot < SLOTS; slot++) {
        const crossing_t none = no_crossing();
        hits[SLOTS * i + slot] = as_hit(&none);
    }

    nearest_t nearest = make_nearest(make_lone_metric(ray.origin), KIND_SPHERES);
    find_nearest(nodes, blocks, sphere_counts[i], &nearest);
    prim_ids[i] = nearest.prim_id;
}
