// The bounds of the rays through a tile of a picture, in the layouts with HAS_ENTRY_POINTS.

// keep: expanded before the branch
#include "rays/camera.cl"
#include "traversal/entry_point.cl"

#if HAS_ENTRY_POINTS

// The directions through the pixels in a tile's corners bound those of all its pixels; they need no normalization,
// because t has no limit. Relative to |forward| + |right| + |up|, a component is rounded by 14 at most: twice 5 by the
// division in x or y, which is up to 2, and 4 by the difference there, a product and two sums. The corners' are, too;
// the normalization, with a division, adds 5 and the slack itself 3.
#define DIRECTION_SLACK ERROR_BOUND(14 + 14 + 5 + 3)

INLINED ray_bounds_t bound_tile(
    const global view_t *view, const int left, const int top, const int tile_width, const int tile_height,
    const int first_row, const int row_count)
{
    const int right = min(left + tile_width, view->width) - 1;
    const int bottom = min(top + tile_height, row_count) - 1;

    float3 lower_direction = (float3)(INFINITY);
    float3 upper_direction = (float3)(-INFINITY);
    for (int corner = 0; corner < 4; corner++) {
        const int column = corner & 1 ? left : right;
        const int row = corner & 2 ? top : bottom;
        const float3 direction = pixel_direction(view, column, first_row + row);
        lower_direction = direction < lower_direction ? direction : lower_direction;
        upper_direction = direction > upper_direction ? direction : upper_direction;
    }
    const float3 size = magnitude(load3(view->forward)) + magnitude(load3(view->right)) + magnitude(load3(view->up));
    const float3 slack = size * DIRECTION_SLACK;
    const float3 eye = load3(view->eye);
    const ray_bounds_t bounds = {
        (float8)(eye, 0.0f, lower_direction - slack, INFINITY),
        (float8)(eye, 0.0f, upper_direction + slack, INFINITY)};
    return bounds;
}

#endif
