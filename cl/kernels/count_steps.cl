// The steps of each ray on its way to the nearest hit, from the root on: a measure of trees, the same on all devices.
//
// Shared arguments: see cl/world/world.cl and cl/world/rays.cl; no ray begins at an entry point.
// steps[ray_count]     written by ray_id

#define COUNT_STEPS 1

#include "world/rays.cl"

kernel void count_steps(WORLD_ARGUMENTS, CAST_ARGUMENTS, global steps_t *restrict steps)
{
    OPEN_BATCH;
    const world_t world = WORLD(root_of(nodes));
    for (int slot = 0; slot < batch.count; slot++) {
        const world_ray_t ray = load_ray(&batch, slot);
        steps_t counted = {0, 0, 0, NO_PRIM};
        search_t search = open_search(&batch, slot, 1, 0);
        search.steps = &counted;
        traverse_world(&world, &ray, true, &search, QUERY_CLOSEST);
        counted.prim_id = search.nearest.prim_id;
        steps[ray_id_of(&batch, slot)] = counted;
    }
}
