// The hits of each ray, in the order along it.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// width                                          rays in a row, see cl/batch.cl
// order[ray_count]                               where results go: the number of each ray; without it its place
// entries[tile_count]                            where each tile enters the tree, see cl/entry.cl; without, at the root
// hits[offsets[ray_count]]                       written; those of ray i are offsets[i] to offsets[i + 1]
// offsets[ray_count + 1]                         running sums of what count_hits found
//
// Where a ray has more hits than places, it gets the nearest ones. Ties are in the order of the face numbers.

#include "entry.cl"

kernel void all_hits(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count,
    const int width, const global int *restrict order, const global node_t *restrict entries, const global int *restrict offsets)
{
    const int place = place_of_ray(width, ray_count);
    if (place == NO_RAY) {
        return;
    }
    const int ray = number_of_ray(order, place);
    const int begin = offsets[ray];
    const int places = offsets[ray + 1] - begin;
    if (places == 0) {
        return;
    }
    const path_t path = load_path(rays + place);
    search_t search = begin_search(places, hits + begin);
    traverse(nodes, find_start(nodes, entries), groups, group_count, &path, &search, QUERY_KEEP);
    sort_hits(&search);
}
