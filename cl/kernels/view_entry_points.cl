// Where the rays of each tile of a band of rows of a picture begin: one work-item per tile.
//
// Shared arguments: see cl/world/world.cl.
// view[1]                                    view_t: the camera, see clbvh/structs.py
// first_row, row_count                       rows of the picture in this band; row 0 is the top
// tile_width, tile_height                    work-group of the kernel that casts the rays, pixels
// margin                                     pixels around the centres of a tile's pixels in which its rays are
// tiles[tile_rows * tile_columns]            tile_t, written in a scene: see cl/instances/start.cl
// entry_points[tile_rows * tile_columns]     node_t, written: see cl/traversal/entry_point.cl
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

// keep: files that both branches need are expanded before them
#include "world/starts.cl"

#if HAS_ENTRY_POINTS

// keep: not in layouts without entry points
#include "rays/camera_tile.cl"

kernel void view_entry_points(
    WORLD_ARGUMENTS, const global view_t *restrict view, const int first_row, const int row_count,
    const int tile_width, const int tile_height, const float margin, START_ARGUMENTS)
{
    ray_bounds_t bounds;
    int tile;
    const bool is_bounded = bound_camera_tile(
        view, get_global_id(0), get_global_id(1), first_row, row_count, tile_width, tile_height, margin, &bounds,
        &tile);
    if (tile == NO_TILE) {
        return;
    }
    if (is_bounded) {
        const world_t world = WORLD(root_of(nodes));
        write_start(&world, &bounds, EVERY_MASK, tiles, entry_points, tile);
    } else {
        write_root_start(tiles, entry_points, tile);
    }
}

#endif
