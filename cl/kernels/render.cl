// A picture: one work-item per pixel finds the closest hit and its colour.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// view[1]                                        camera, light and colours
// first_row, row_count                           the rows of the picture that this launch renders
// colours[row_count * width]                     written; red, green, blue, and 255 where something is hit
// hits[row_count * width]                        written; t in object units
//
// Work-items: (width, row_count). A work-group is a tile, so that its rays run through the same nodes.

#include "camera.cl"
#include "shade.cl"

kernel void render(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global view_t *restrict view, const int first_row, const int row_count,
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
    traverse(nodes, groups, group_count, &path, &search, QUERY_CLOSEST);
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
