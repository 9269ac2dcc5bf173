// Finds where the rays of a tile begin, from bounds of its rays: see world/world.cl.
//
// tiles[tile_count]            tile_t, written: see instances/start.cl; NULL with a lone shape
// entry_points[tile_count]     node_t, written: see traversal/entry_point.cl

// keep: expanded before the branches
#include "traversal/entry_point.cl"
#include "world/world.cl"

#if HAS_ENTRY_POINTS

#if !LONE
#include "instances/entry_point.cl"
#endif

#define START_ARGUMENTS global tile_t *restrict tiles, global node_t *restrict entry_points

// Writes the start of a tile, given the bits of all masks of its rays.
INLINED void write_start(
    const world_t *world, const ray_bounds_t *bounds, const uint mask, global tile_t *tiles,
    global node_t *entry_points, const int tile)
{
#if LONE
    find_entry_point(world->nodes, bounds, entry_points + tile);
#else
    find_tile(
        world->top_nodes, world->instances, world->nodes, bounds, mask, tiles + tile, entry_points + tile);
#endif
}

// Lets the rays of a tile begin at the root.
INLINED void write_root_start(global tile_t *tiles, global node_t *entry_points, const int tile)
{
#if LONE
    clear_child(entry_points + tile, 0, ROOT);
#else
    skip_tile(tiles + tile);
#endif
}

#endif
