// Where the rays of each tile of a batch begin in a scene: one work-item per tile.
//
// Shared arguments: see cl/instances/traverse.cl and cl/instances/batch.cl.
// tile_width, tile_height                       work-group of the kernel that casts the rays
// tiles[tile_rows * tile_columns]               scene_tile_t, written: see cl/instances/start.cl
// entry_points[tile_rows * tile_columns]        node_t, written
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

// keep: expanded before the branch
#include "instances/batch.cl"
#include "instances/entry_point.cl"

#if HAS_ENTRY_POINTS

kernel void scene_tile_entry_points(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global packed_ray_t *restrict rays,
    const global scene_low_t *restrict lows, const int low_step, const int ray_count, const int row_length,
    const int tile_width, const int tile_height, global scene_tile_t *restrict tiles,
    global node_t *restrict entry_points)
{
    const int tile_columns = (row_length + tile_width - 1) / tile_width;
    const int first_column = tile_width * get_global_id(0);
    const int first_row = tile_height * get_global_id(1);
    if (first_column >= row_length || first_row * row_length >= ray_count) {
        return;
    }
    const int column_count = min(tile_width, row_length - first_column);
    const int row_count = min(tile_height, (ray_count - first_row * row_length + row_length - 1) / row_length);
    const int tile = get_global_id(1) * tile_columns + get_global_id(0);

    ray_bounds_t bounds = empty_bounds();
    uint mask = 0;
    for (int row = first_row; row < first_row + row_count; row++) {
        for (int column = first_column; column < first_column + column_count; column++) {
            const int ray = row * row_length + column;
            if (ray < ray_count) {
                include_ray(&bounds, ((const global float8 *)rays)[ray]);
                mask |= lows[low_step * ray].mask;
            }
        }
    }
    find_scene_tile(top_nodes, instances, nodes, &bounds, mask, tiles + tile, entry_points + tile);
}

#endif
