// The entry point of each tile of a batch: one work-item per tile.
//
// Shared arguments: see cl/rays/batch.cl.
// tile_width, tile_height                       work-group of the kernel that casts the rays
// entry_points[tile_rows * tile_columns]        node_t, written: see cl/traversal/entry_point.cl
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

#include "traversal/entry_point.cl"

#if HAS_ENTRY_POINTS

kernel void tile_entry_points(
    const global node_t *restrict nodes, const global packed_ray_t *restrict rays, const int ray_count,
    const int row_length, const int tile_width, const int tile_height, global node_t *restrict entry_points)
{
    const int tile_columns = (row_length + tile_width - 1) / tile_width;
    const int first_column = tile_width * get_global_id(0);
    const int first_row = tile_height * get_global_id(1);
    if (first_column >= row_length || first_row * row_length >= ray_count) {
        return;
    }
    const int column_count = min(tile_width, row_length - first_column);
    const int row_count = min(tile_height, (ray_count - first_row * row_length + row_length - 1) / row_length);
    global node_t *entry_point = entry_points + get_global_id(1) * tile_columns + get_global_id(0);

    ray_bounds_t bounds = empty_bounds();
    for (int row = first_row; row < first_row + row_count; row++) {
        for (int column = first_column; column < first_column + column_count; column++) {
            // That of the tile after the next one.
            WILL_READ(rays + row * row_length + column + 2 * tile_width);
            if (row * row_length + column < ray_count) {
                include_ray(&bounds, ((const global float8 *)rays)[row * row_length + column]);
            }
        }
    }
    find_entry_point(nodes, &bounds, entry_point);
}

#endif
