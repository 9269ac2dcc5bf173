// A band of rows of a picture: the closest hit and the colour of each pixel.
//
// nodes[node_count]                          node_t: the tree in its layout, see clbvh/structs.py
// blocks[block_count]                        block_t: triangles in leaf order, local coordinates
// entry_points[tile_rows * tile_columns]     node_t, see cl/kernels/view_entry_points.cl. NULL: rays begin
//                                            at the root
// view[1]                                    view_t: camera, light and colours, see clbvh/structs.py
// first_row, row_count                       rows of the picture in this band; row 0 is the top
// colours[row_count * width]                 written: red, green, blue, and 255 where something is hit
// hits[row_count * width]                    written: t in local units
//
// Work-items: (width, row_count), rounded up to tiles.

#include "rays/camera.cl"
#include "traversal/entry_point.cl"
#include "shading/shade.cl"
#include "shading/shadow.cl"

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
        colour = has_range(ray.t_max) ? shade_background(view, row) : (float3)(0.0f);
    } else {
        const corners_t corners = corners_at(blocks, nearest.triangle_index);
        const surface_t surface = surface_at(&corners, &nearest, ray.direction);
        const bool is_lit = sees_light(view, &surface, nodes, blocks, block_count);
        colour = shade_surface(view, load3(view->surface_colour), surface.position, surface.normal, is_lit);
    }
    colours[pixel] = as_pixel(colour, is_found(&nearest));
}
