// The first hits of each ray, in the order along it; ties are in the order of instance_id, then of prim_id.
//
// A ray that fills its slots may have more hits: the host casts it again with more slots.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl.
// slots                       results per ray, at least 1
// hits[ray_count * slots]     written: the hits of a ray begin at ray_id * slots; a miss (prim_id NO_PRIM) follows if
//                             slots are left, and further slots are not written

#include "world/rays.cl"

kernel void first_hits(WORLD_ARGUMENTS, CAST_ARGUMENTS, global kept_hit_t *restrict hits, const int slots)
{
    OPEN_BATCH;
    const world_t world = WORLD(batch.start);
    for (int slot = 0; slot < batch.count; slot++) {
        global kept_hit_t *own = hits + (size_t)ray_id_of(&batch, slot) * slots;
        const world_ray_t ray = load_ray(&batch, slot);
        search_t search = open_search(&batch, slot, slots, own);
        traverse_world(&world, &ray, true, &search, QUERY_FIRST);
        sort_hits(&search);
        if (search.count < slots) {
            own[search.count].prim_id = NO_PRIM;
        }
    }
}
