// Where the rays of each tile of a band of rows of a picture begin: one work-item per tile.
//
// Shared arguments: see cl/world/world.cl.
// view[1]                                    view_t: the camera, see clbvh/structs.py
// first_row, row_count                       rows of the picture in this band; row 0 is the top
// tile_width, tile_height                    work-group of the kernel that casts the rays, pixels
// margin                                     pixels around the centres of a tile's pixels in which its rays are
// tiles[tile_rows * tile_columns]            scene_tile_t, written in a scene: see cl/instances/start.cl
// entry_points[tile_rows * tile_columns]     node_t, written: see cl/traversal/entry_point.cl
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

// keep: files that both branches need are expanded before them
#include "traversal/entry_point.cl"
#include "world/world.cl"

#if HAS_ENTRY_POINTS

// keep: not in layouts without entry points
#include "rays/camera_tile.cl"
#if HAS_INSTANCES
#include "instances/entry_point.cl"
#endif

kernel void view_entry_points(
    const global node_t *restrict nodes, const global bvh2_node_t *restrict top_nodes,
    const global instance_t *restrict instances, const global view_t *restrict view, const int first_row,
    const int row_count, const int tile_width, const int tile_height, const float margin,
    global scene_tile_t *restrict tiles, global node_t *restrict entry_points)
{
    ray_bounds_t bounds;
    int tile;
    const bool is_bounded =
        bound_camera_tile(view, first_row, row_count, tile_width, tile_height, margin, &bounds, &tile);
    if (tile == NO_TILE) {
        return;
    }
#if HAS_INSTANCES
    if (is_bounded) {
        find_scene_tile(top_nodes, instances, nodes, &bounds, EVERY_MASK, tiles + tile, entry_points + tile);
    } else {
        skip_scene_tile(tiles + tile);
    }
#else
    if (is_bounded) {
        find_entry_point(nodes, &bounds, entry_points + tile);
    } else {
        clear_child(entry_points + tile, 0, ROOT);
    }
#endif
}

#endif
