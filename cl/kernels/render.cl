// A band of rows of a picture: `view_entry_points` finds the entry point of each tile, `render` the closest hit and the
// colour of each pixel.
//
// nodes[node_count]                          node_t: the tree in its layout, see clbvh/structs.py
// blocks[block_count]                        block_t: triangles in leaf order, local coordinates
// view[1]                                    view_t: camera, light and colours, see clbvh/structs.py
// first_row, row_count                       rows of the picture in this band; row 0 is the top
// tile_width, tile_height                    work-group of `render`, pixels
// margin                                     pixels: how far the rays of a pixel may be from its centre
// entry_points[tile_rows * tile_columns]     node_t, see cl/traversal/entry_point.cl: written by `view_entry_points`.
//                                            NULL for `render`: all rays begin at the root
// colours[row_count * width]                 written: red, green, blue, and 255 where something is hit
// hits[row_count * width]                    written: t in local units
//
// Work-items: (tile_columns, tile_rows) for `view_entry_points`; (width, row_count) for `render`, rounded up to tiles.

#include "rays/camera.cl"
#include "traversal/entry_point.cl"
#include "shading/shade.cl"
#include "shading/shadow.cl"

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

kernel void render(
    const global node_t *restrict nodes, const global block_t *restrict blocks, const int block_count,
    const global node_t *restrict entry_points, const global view_t *restrict view, const int first_row,
    const int row_count, global uchar4 *restrict colours, global hit_t *restrict hits)
{
    const int column = get_global_id(0);
    const int band_row = get_global_id(1);
    if (column >= view->width || band_row >= row_count) {
        return;
    }
    const int pixel = band_row * view->width + column;
    const int row = first_row + band_row;

    const ray_t ray = primary_ray(view, column, row);
    search_t search = make_search(1, 0);
    traverse(nodes, find_start_node(nodes, entry_points), blocks, block_count, &ray, &search, QUERY_CLOSEST);
    const crossing_t nearest = search.nearest;
    hits[pixel] = as_hit(&nearest);

    float3 colour;
    if (!is_found(&nearest)) {
        colour = has_range(&ray) ? shade_background(view, row) : (float3)(0.0f);
    } else {
        const corners_t corners = corners_at(blocks, nearest.triangle_index);
        const surface_t surface = surface_at(&corners, &nearest, ray.direction);
        const bool is_lit = sees_light(view, &surface, nodes, blocks, block_count);
        colour = shade_surface(view, load3(view->surface_colour), surface.position, surface.normal, is_lit);
    }
    colours[pixel] = as_pixel(colour, is_found(&nearest));
}
