// The entry point of each tile of a band of rows of a picture: one work-item per tile.
//
// nodes[node_count]                          node_t: the tree in its layout, see clbvh/structs.py
// view[1]                                    view_t: the camera, see clbvh/structs.py
// first_row, row_count                       rows of the picture in this band; row 0 is the top
// tile_width, tile_height                    work-group of the kernel that casts the rays, pixels
// margin                                     pixels around the centres of a tile's pixels in which its rays are
// entry_points[tile_rows * tile_columns]     node_t, written: see cl/traversal/entry_point.cl
//
// Work-items: (tile_columns, tile_rows). Layouts without entry points have no such kernel.

#include "rays/camera.cl"
#include "traversal/entry_point.cl"

#if HAS_ENTRY_POINTS

#include "rays/camera_bounds.cl"

kernel void view_entry_points(
    const global node_t *restrict nodes, const global view_t *restrict view, const int first_row, const int row_count,
    const int tile_width, const int tile_height, const float margin, global node_t *restrict entry_points)
{
    const int tile_columns = (view->width + tile_width - 1) / tile_width;
    const int left = tile_width * get_global_id(0);
    const int top = tile_height * get_global_id(1);
    if (left >= view->width || top >= row_count) {
        return;
    }
    const int right = min(left + tile_width, view->width) - 1;
    const int bottom = min(top + tile_height, row_count) - 1;
    const float2 beyond = 2.0f * margin / (float2)(view->width, view->height);
    const float2 upper_left = pixel_centre(view, left, first_row + top) + (float2)(-beyond.x, beyond.y);
    const float2 lower_right = pixel_centre(view, right, first_row + bottom) + (float2)(beyond.x, -beyond.y);

    global node_t *entry_point = entry_points + get_global_id(1) * tile_columns + get_global_id(0);
    ray_bounds_t bounds;
    if (bound_camera_rays(
            view, (float2)(upper_left.x, lower_right.y), (float2)(lower_right.x, upper_left.y), &bounds)) {
        find_entry_point(nodes, &bounds, entry_point);
    } else {
        clear_child(entry_point, 0, ROOT);
    }
}

#endif
