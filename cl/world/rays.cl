// A batch of rays in memory that are cast at a world; rays/batch.cl tells how it is laid out. A work-item casts one
// ray. That of the host casts those of a tile, see on_host/world/rays.cl, whose functions have the same names.
//
// Arguments that the kernels of rays share:
//
// rays[ray_count]             packed_ray_t: the world's local coordinates; t in lengths of the direction
// lows[1 or ray_count]        ray_low_t: of all rays, or one for each; NULL with a lone shape
// low_step                    0 or 1, by which of the two it is
// row_length                  rays per row
//
// And those that cast them:
//
// order[ray_count]            see rays/batch.cl
// tiles[], entry_points[]     where the rays of each tile begin, see world/starts.cl. NULL: all begin at the root
// side                        of primitives that rays see, see hits/search.cl
// excluded[ray_count]         the primitive that each ray does not see; NULL: none

// keep: the kernels of rays use it
#include "rays/batch.cl"
#include "world/world.cl"

#define RAY_ARGUMENTS \
    const global packed_ray_t *restrict rays, const global ray_rest_t *restrict lows, const int low_step, \
    const int ray_count, const int row_length

#define CAST_ARGUMENTS \
    RAY_ARGUMENTS, const global int *restrict order, const global tile_t *restrict tiles, \
    const global node_t *restrict entry_points, const int side, const global world_prim_t *restrict excluded

// Prefetch distance in rays: in the same row of a picture, three tiles on.
#define PREFETCH_RAYS 24

// The rays of a work-item, and where they begin.
typedef struct {
    start_t start;
    int count;
    int ray_index;
    const global packed_ray_t *rays;
    const global ray_rest_t *lows;
    int low_step;
    const global int *order;
    int side;
    const global world_prim_t *excluded;
} batch_t;

INLINED batch_t make_batch(
    const start_t start, const int ray_index, const global packed_ray_t *rays, const global ray_rest_t *lows,
    const int low_step, const global int *order, const int side, const global world_prim_t *excluded)
{
    const batch_t batch = {
        start, ray_index == NO_RAY ? 0 : 1, ray_index, rays, lows, low_step, order, side, excluded};
    return batch;
}

// Declares the `batch` of a work-item, from the arguments that kernels share.
#define OPEN_BATCH \
    const batch_t batch = make_batch( \
        find_start(nodes, tiles, entry_points, TILE_INDEX), \
        find_ray_index(get_global_id(0), get_global_id(1), ray_count, row_length), rays, lows, low_step, order, \
        side, excluded)

// The number by which the results of a ray are written.
INLINED int ray_id_of(const batch_t *batch, const int slot)
{
    return batch->order ? batch->order[batch->ray_index] : batch->ray_index;
}

// A search for hits of a ray, see make_search.
INLINED search_t
open_search(const batch_t *batch, const int slot, const int max_count, global kept_hit_t *heap)
{
    search_t search = make_search(max_count, heap);
    limit_sight(&search, batch->side, batch->excluded ? batch->excluded + batch->ray_index : 0);
    return search;
}

// Loads a ray of the batch, and asks for a later one.
INLINED world_ray_t load_ray(const batch_t *batch, const int slot)
{
    const global packed_ray_t *ray = batch->rays + batch->ray_index;
    WILL_READ(ray + PREFETCH_RAYS);
#if LONE && !EXACT
    return unpack_ray(ray);
#else
    return unpack_ray_pair(ray, batch->lows + batch->low_step * batch->ray_index);
#endif
}
