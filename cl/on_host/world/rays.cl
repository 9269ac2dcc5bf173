// Rays in arrays of the user that the host casts at a world, in the place of world/rays.cl. A work-item packs the rays
// of a tile, finds where they begin, and casts them one after the other, all of it in the cache.
//
// Arguments that the kernels of rays share, besides those of cl/rays/arrays.cl:
//
// box[7]                      of the world: the centre, half the size along each axis, and the scale, see `TreeBox`
// order[ray_count]            the rays to cast, by their numbers; NULL: all in their own order
// is_by_place                 whether results are written by the place of a ray in that order, and not by its number
// row_length                  rays per row, see rays/batch.cl
// tile_width, tile_height     MOST_TILE_RAYS at most
// finds_start                 whether a tile's rays may begin elsewhere than at the root
// bad                         lowered to the number of a ray that is not finite, has no direction, or is too far
// side                        of primitives that rays see, see hits/search.cl
// excluded[ray_count]         the primitive that each ray does not see, by its number; NULL: none
//
// Work-items: (tile_columns, tile_rows).

// keep: the kernels of rays use it
#include "rays/arrays.cl"
#include "rays/store.cl"
#include "world/starts.cl"
#include "world/world.cl"
#if HAS_ENTRY_POINTS
#include "boxes/beam.cl"
#endif

#define CAST_ARGUMENTS \
    ARRAY_ARGUMENTS, const global double *restrict box, const global int *restrict order, const int is_by_place, \
    const int row_length, const int tile_width, const int tile_height, const int finds_start, \
    global int *restrict bad, const int side, const global world_prim_t *restrict excluded

// Prefetch distance in rays: a tile of them, and some more.
#define COMING_RAYS 40

// All numbers of a packed ray, see boxes/beam.cl.
typedef float8 ray_lanes_t __attribute__((aligned(16)));

// The rays of a tile.
typedef struct {
    start_t start;
    int count;
    int side;
    const world_prim_t *excluded;
    int number[MOST_TILE_RAYS];
    int ray_id[MOST_TILE_RAYS];
    packed_ray_t ray[MOST_TILE_RAYS];
#if !LONE || EXACT
    ray_rest_t rest[MOST_TILE_RAYS];
#endif
#if HAS_ENTRY_POINTS
    // Rays load its lanes as whole vectors, see math/lanes.cl, and a node is aligned to less by itself.
    node_t entry_point __attribute__((aligned(sizeof(lanes_t))));
#if !LONE
    tile_t tile;
#endif
#endif
} batch_t;

// What is told of all tiles.
typedef struct {
    ray_arrays_t arrays;
    int ray_count;
    const int *order;
    int is_by_place;
    int row_length;
    int width;
    int height;
} tiling_t;

INLINED void list_rays(const tiling_t *tiling, const int column, const int row, batch_t *batch)
{
    const int first_column = column * tiling->width, first_row = row * tiling->height;
    const int end_column = min(first_column + tiling->width, tiling->row_length);
    batch->count = 0;
    for (int y = first_row; y < first_row + tiling->height; y++) {
        const int end = min(y * tiling->row_length + end_column, tiling->ray_count);
        for (int place = y * tiling->row_length + first_column; place < end; place++) {
            const int number = tiling->order ? tiling->order[place] : place;
            batch->number[batch->count] = number;
            batch->ray_id[batch->count] = tiling->is_by_place ? place : number;
            batch->count++;
        }
    }
}

// A ray that hits nothing, in the place of a bad one.
INLINED wide_ray_t make_empty_ray(void)
{
    const wide_ray_t ray = {(double3)(0.0), (double3)(1.0), 0.0, -1.0};
    return ray;
}

// Asks for a ray that is cast later, where rays are in an order of their own.
INLINED void will_read_coming(const tiling_t *tiling, const int place)
{
    if (tiling->order && place < tiling->ray_count) {
        const ray_place_t coming = find_ray_place(&tiling->arrays, tiling->order[place]);
        will_read_ray(&tiling->arrays, &coming);
    }
}

// Packs the rays of a tile. With each, one of a later tile is asked for: of many at once, processors drop some.
INLINED void pack_tile(
    const tiling_t *tiling, const int first, const tree_box_t *box, int *bad, batch_t *batch)
{
    for (int slot = 0; slot < batch->count; slot++) {
        will_read_coming(tiling, first + slot + COMING_RAYS);
        const ray_place_t place = find_ray_place(&tiling->arrays, batch->number[slot]);
        wide_ray_t ray = load_wide_ray(&tiling->arrays, &place);
        if (localize_ray(&ray, box) == BAD_RAY) {
            atomic_min(bad, batch->number[slot]);
            ray = make_empty_ray();
        }
#if LONE && !EXACT
        store_ray(&ray, 0, batch->ray + slot, 0);
#else
        store_ray(&ray, load_mask(&tiling->arrays, &place), batch->ray + slot, batch->rest + slot);
#endif
    }
}

#if HAS_ENTRY_POINTS
INLINED start_t find_start_of_tile(const world_t *world, batch_t *batch)
{
    ray_bounds_t bounds = empty_bounds();
    uint mask = 0;
    for (int slot = 0; slot < batch->count; slot++) {
        include_ray(&bounds, *(const ray_lanes_t *)(batch->ray + slot));
#if !LONE
        mask |= batch->rest[slot].mask;
#endif
    }
#if LONE
    write_start(world, &bounds, mask, 0, &batch->entry_point, 0);
    return find_start(world->nodes, 0, &batch->entry_point, 0);
#else
    write_start(world, &bounds, mask, &batch->tile, &batch->entry_point, 0);
    return find_start(world->nodes, &batch->tile, &batch->entry_point, 0);
#endif
}
#endif

INLINED void open_batch(
    const tiling_t *tiling, const int column, const int row, const double *box, const world_t *world,
    const int finds_start, int *bad, batch_t *batch)
{
    const tree_box_t tree_box = load_tree_box(box);
    list_rays(tiling, column, row, batch);
    // Rays in an order of their own are one row.
    pack_tile(tiling, column * tiling->width, &tree_box, bad, batch);
    batch->start = world->start;
#if HAS_ENTRY_POINTS
    if (finds_start) {
        batch->start = find_start_of_tile(world, batch);
    }
#endif
}

// Declares the `batch` of a work-item, from the arguments that kernels share.
#define OPEN_BATCH \
    const tiling_t tiling = {ARRAYS, ray_count, order, is_by_place, row_length, tile_width, tile_height}; \
    const world_t at_root = WORLD(root_of(nodes)); \
    batch_t batch; \
    batch.side = side; \
    batch.excluded = excluded; \
    open_batch(&tiling, get_global_id(0), get_global_id(1), box, &at_root, finds_start, bad, &batch)

// The number by which the results of a ray are written.
INLINED int ray_id_of(const batch_t *batch, const int slot)
{
    return batch->ray_id[slot];
}

INLINED search_t
open_search(const batch_t *batch, const int slot, const int max_count, global kept_hit_t *heap)
{
    search_t search = make_search(max_count, heap);
    limit_sight(&search, batch->side, batch->excluded ? batch->excluded + batch->number[slot] : 0);
    return search;
}

INLINED world_ray_t load_ray(const batch_t *batch, const int slot)
{
#if LONE && !EXACT
    return unpack_ray(batch->ray + slot);
#else
    return unpack_ray_pair(batch->ray + slot, batch->rest + slot);
#endif
}
