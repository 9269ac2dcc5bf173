// A batch of rays in memory that are cast at a world; rays/batch.cl tells how it is laid out.
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

// keep: the kernels of rays use it
#include "rays/batch.cl"
#include "world/world.cl"

#define RAY_ARGUMENTS \
    const global packed_ray_t *restrict rays, const global ray_rest_t *restrict lows, const int low_step, \
    const int ray_count, const int row_length

#define CAST_ARGUMENTS \
    RAY_ARGUMENTS, const global int *restrict order, const global tile_t *restrict tiles, \
    const global node_t *restrict entry_points

// Prefetch distance in rays: in the same row of a picture, three tiles on.
#define PREFETCH_RAYS 24

// Loads a ray of the batch, and asks for a later one.
INLINED world_ray_t load_ray(
    const global packed_ray_t *rays, const global ray_rest_t *lows, const int low_step, const int ray_index)
{
    WILL_READ(rays + ray_index + PREFETCH_RAYS);
#if LONE && !EXACT
    return unpack_ray(rays + ray_index);
#else
    return unpack_ray_pair(rays + ray_index, lows + low_step * ray_index);
#endif
}
