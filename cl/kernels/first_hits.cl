// The first hits of each ray, in the order along it; ties are in the order of prim_id.
//
// A ray that fills its slots may have more hits: the host casts it again with more slots.
//
// Shared arguments: see cl/rays/batch.cl.
// slots                       results per ray, at least 1
// hits[ray_count * slots]     written: the hits of a ray begin at ray_id * slots; a miss (prim_id NO_PRIM) follows if
//                             slots are left, and further slots are not written

#include "rays/batch.cl"
#include "traversal/entry_point.cl"

kernel void first_hits(
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count,
    const global packed_ray_t *restrict rays, global kept_hit_t *restrict hits, const int ray_count,
    const int row_length, const global int *restrict order, const global node_t *restrict entry_points,
    const int slots)
{
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return;
    }
    const int ray_id = find_ray_id(ray_index, order);
    const ray_t ray = load_ray(rays, ray_index);
    global kept_hit_t *hits_of_ray = hits + (size_t)ray_id * slots;
    search_t search = make_search(slots, hits_of_ray);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_FIRST);
    sort_hits(&search);
    if (search.count < slots) {
        hits_of_ray[search.count].prim_id = NO_PRIM;
    }
}
