// Where the rays of each tile of a batch begin: one work-item per tile.
//
// Shared arguments: see cl/world/world.cl, cl/world/rays.cl and cl/world/starts.cl.
// tile_width, tile_height     work-group of the kernel that casts the rays
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

#include "world/rays.cl"
#include "world/starts.cl"

#if HAS_ENTRY_POINTS

// keep: not in layouts without entry points
#include "boxes/beam.cl"

kernel void tile_entry_points(
    WORLD_ARGUMENTS, RAY_ARGUMENTS, START_ARGUMENTS, const int tile_width, const int tile_height)
{
    const int tile_columns = (row_length + tile_width - 1) / tile_width;
    const int first_column = tile_width * get_global_id(0);
    const int first_row = tile_height * get_global_id(1);
    if (first_column >= row_length || first_row * row_length >= ray_count) {
        return;
    }
    const int column_count = min(tile_width, row_length - first_column);
    const int row_count = min(tile_height, (ray_count - first_row * row_length + row_length - 1) / row_length);

    ray_bounds_t bounds = empty_bounds();
    uint mask = 0;
    for (int row = first_row; row < first_row + row_count; row++) {
        for (int column = first_column; column < first_column + column_count; column++) {
            const int ray = row * row_length + column;
            // That of the tile after the next one.
            WILL_READ(rays + ray + 2 * tile_width);
            if (ray < ray_count) {
                include_ray(&bounds, ((const global float8 *)rays)[ray]);
#if !LONE
                mask |= lows[low_step * ray].mask;
#endif
            }
        }
    }
    const world_t world = WORLD(root_of(nodes));
    write_start(&world, &bounds, mask, tiles, entry_points, get_global_id(1) * tile_columns + get_global_id(0));
}

#endif
