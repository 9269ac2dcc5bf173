// The nearest hit of each ray, in the place of kernels/closest_hit.cl: computed again in double while the rays of a
// tile are in the cache.
//
// Shared arguments: see cl/world/world.cl and on_host/world/rays.cl.
// hits[ray_count]     written by ray_id as there, unless NULL
// surfaces            `SurfaceArrays.addresses`
// t[ray_count], ..., instance_id[ray_count]    written by ray_id: refined hits. With t NULL none but prim_id is, and
//                     with prim_id NULL nothing. instance_id is NULL with a lone shape

#include "hits/found.cl"
#include "hits/refined.cl"
#include "world/rays.cl"

// Refines the hits of a tile's rays, and writes them.
INLINED void refine_tile(
    const surfaces_t *surfaces, const ray_arrays_t *arrays, const batch_t *batch, const found_hits_t *found,
    const refined_hits_t *hits)
{
    // A primitive and its corners are asked for in two steps, since the first tells where the others are.
    for (int slot = 0; slot < batch->count; slot++) {
        will_read_prim(surfaces, found, slot);
        will_write_hit(hits, batch->ray_id[slot]);
    }
    for (int slot = 0; slot < batch->count; slot++) {
        will_read_corners(surfaces, found, slot);
    }
    for (int slot = 0; slot < batch->count; slot++) {
        if (prim_of(found, slot) == NO_PRIM) {
            write_miss(hits, batch->ray_id[slot]);
        } else {
            const ray_place_t place = find_ray_place(arrays, batch->number[slot]);
            const wide_ray_t ray = load_wide_ray(arrays, &place);
            refine_found(surfaces, &ray, found, slot, hits, batch->ray_id[slot]);
        }
    }
}

kernel void closest_hit(
    WORLD_ARGUMENTS, CAST_ARGUMENTS, global kept_hit_t *restrict hits, const global ulong *restrict surfaces,
    global double *restrict t, global double *restrict u, global double *restrict v, global uchar *restrict is_front,
    global int *restrict prim_id, global int *restrict instance_id)
{
    OPEN_BATCH;
    const world_t world = WORLD(batch.start);
    kept_hit_t found[MOST_TILE_RAYS];
    for (int slot = 0; slot < batch.count; slot++) {
        search_t search = open_search(&batch, slot, 1, 0);
        if (!meets_nothing(&world.start)) {
            const world_ray_t ray = load_ray(&batch, slot);
            traverse_world(&world, &ray, true, &search, QUERY_CLOSEST);
        }
        found[slot] = as_kept_hit(&search, &search.nearest);
    }
    if (hits) {
        for (int slot = 0; slot < batch.count; slot++) {
            hits[batch.ray_id[slot]] = found[slot];
        }
    }
    if (!t && prim_id) {
        for (int slot = 0; slot < batch.count; slot++) {
            prim_id[batch.ray_id[slot]] = found[slot].prim_id;
        }
    }
    if (t) {
        const refined_hits_t refined = {t, u, v, is_front, prim_id, instance_id};
        const surfaces_t of_world = surfaces_on_host(surfaces);
        const found_hits_t hits_of_tile = FOUND_HITS(found);
        refine_tile(&of_world, &tiling.arrays, &batch, &hits_of_tile, &refined);
    }
}
