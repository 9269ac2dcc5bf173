// A picture: where the primary rays of each tile enter the tree, and one work-item per pixel that finds the closest hit and
// its colour.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// view[1]                                        camera, light and colours
// first_row, row_count                           the rows of the picture that this launch renders
// tile_width, tile_height                        the work-groups of `render`
// entries[tile_rows * tile_columns]              of each tile, see cl/entry.cl; `render` takes NULL for none
// colours[row_count * width]                     written; red, green, blue, and 255 where something is hit
// hits[row_count * width]                        written; t in object units
//
// Work-items: of `view_entries` (tile_columns, tile_rows), of `render` (width, row_count).

#include "camera.cl"
#include "entry.cl"
#include "shade.cl"

#if HAS_ENTRIES

// The beam of primary rays is that of the pixels in the tile's corners, whatever the length of directions. A component
// is rounded eight times on the way to a ray: to x or y four times, two products and sums, and by normalize.
#define DIRECTION_SLACK ERROR_BOUND(16)

kernel void view_entries(
    const global node_t *restrict nodes, const global view_t *restrict view, const int first_row, const int row_count,
    const int tile_width, const int tile_height, global node_t *restrict entries)
{
    const int tile_columns = (view->width + tile_width - 1) / tile_width;
    const int left = tile_width * get_global_id(0);
    const int top = tile_height * get_global_id(1);
    if (left >= view->width || top >= row_count) {
        return;
    }
    const int right = min(left + tile_width, view->width) - 1;
    const int bottom = min(top + tile_height, row_count) - 1;

    float3 least = (float3)(INFINITY);
    float3 most = (float3)(-INFINITY);
    for (int corner = 0; corner < 4; corner++) {
        const int column = corner & 1 ? left : right;
        const int row = corner & 2 ? top : bottom;
        const float3 direction = through_pixel(view, column, first_row + row);
        least = direction < least ? direction : least;
        most = direction > most ? direction : most;
    }
    const float3 size = magnitude(load3(view->forward)) + magnitude(load3(view->right)) + magnitude(load3(view->up));
    const float3 slack = size * DIRECTION_SLACK;
    const float3 eye = load3(view->eye);
    const ray_bounds_t bounds = {
        (float8)(eye, 0.0f, least - slack, INFINITY), (float8)(eye, 0.0f, most + slack, INFINITY)};
    find_entry(nodes, &bounds, entries + get_global_id(1) * tile_columns + get_global_id(0));
}

#endif

kernel void render(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global node_t *restrict entries, const global view_t *restrict view, const int first_row, const int row_count,
    global uchar4 *restrict colours, global hit_t *restrict hits)
{
    const int column = get_global_id(0);
    const int band_row = get_global_id(1);
    if (column >= view->width || band_row >= row_count) {
        return;
    }
    const int pixel = band_row * view->width + column;
    const int row = first_row + band_row;

    const path_t path = primary_path(view, column, row);
    search_t search = begin_search(1, 0);
    traverse(nodes, find_start(nodes, entries), groups, group_count, &path, &search, QUERY_CLOSEST);
    const crossing_t nearest = search.nearest;
    hits[pixel] = as_hit(&nearest);

    float3 colour;
    if (!is_found(&nearest)) {
        colour = shade_background(view, row);
    } else {
        const corners_t corners = corners_at(groups, nearest.place);
        const surface_t surface = surface_at(&corners, &nearest, path.direction);
        switch (view->shading) {
        case SHADE_NORMAL:
            colour = 0.5f * surface.normal + 0.5f;
            break;
        case SHADE_DEPTH:
            colour = shade_depth(view, surface.position);
            break;
        case SHADE_LAMBERT_SHADOW:
            colour = shade_lambert(
                view, surface.normal, sees_light(view, &surface, nodes, groups, group_count));
            break;
        default:
            colour = shade_lambert(view, surface.normal, true);
        }
    }
    colours[pixel] = (uchar4)(convert_uchar3_sat_rte(255.0f * colour), is_found(&nearest) ? 255 : 0);
}
