// The number of hits of each ray between t_min and t_max.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// max_hits              limit of a count, at least 1; a ray that reaches it is not followed further
// counts[ray_count]     written by ray_id

#include "world/rays.cl"

kernel void count_hits(WORLD_ARGUMENTS, CAST_ARGUMENTS, global int *restrict counts, const int max_hits)
{
    OPEN_BATCH;
    const world_t world = WORLD(batch.start);
    for (int slot = 0; slot < batch.count; slot++) {
        global int *own = counts + ray_id_of(&batch, slot);
        WILL_WRITE(own);
        const world_ray_t ray = load_ray(&batch, slot);
        search_t search = open_search(&batch, slot, max_hits, 0);
        traverse_world(&world, &ray, true, &search, QUERY_COUNT);
        *own = search.count;
    }
}
