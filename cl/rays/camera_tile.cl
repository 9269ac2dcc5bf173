// Bounds of the rays that a camera sends through the pixels of a tile.

#include "rays/camera.cl"
#include "rays/camera_bounds.cl"

// Finds the bounds of the rays of a tile, by its column and row. Its rays go through points of the picture within a
// margin, in pixels, around the centres of its pixels. Returns whether there are bounds. *tile becomes the index of the
// tile, or NO_TILE beyond the edges of the band.
#define NO_TILE -1

INLINED bool bound_camera_tile(
    const global view_t *view, const int column, const int row, const int first_row, const int row_count,
    const int tile_width, const int tile_height, const float margin, ray_bounds_t *bounds, int *tile)
{
    const int tile_columns = (view->width + tile_width - 1) / tile_width;
    const int left = tile_width * column;
    const int top = tile_height * row;
    *tile = NO_TILE;
    if (left >= view->width || top >= row_count) {
        return false;
    }
    *tile = row * tile_columns + column;
    const int right = min(left + tile_width, view->width) - 1;
    const int bottom = min(top + tile_height, row_count) - 1;
    const float2 beyond = 2.0f * margin / (float2)(view->width, view->height);
    const float2 upper_left = pixel_centre(view, left, first_row + top) + (float2)(-beyond.x, beyond.y);
    const float2 lower_right = pixel_centre(view, right, first_row + bottom) + (float2)(beyond.x, -beyond.y);
    return bound_camera_rays(
        view, (float2)(upper_left.x, lower_right.y), (float2)(lower_right.x, upper_left.y), bounds);
}
