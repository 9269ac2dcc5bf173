// A band of rows of a picture, in the shadings of the report: the closest hit and the colour of each pixel.
//
// Shared arguments: see cl/world/world.cl.
// instance_colours[4 * instance_count]   by instance_id: linear red, green, blue, and whether the instance has a colour
//                                        of its own, 0 or 1; without, it has that of the view
// closed[instance_count]                 by instance_id: whether it encloses a volume; NULL without a cut
// view[1]                                view_t: camera, light and colours, see clbvh/structs.py
// first_row, row_count                   rows of the picture in this band; row 0 is the top
// colours[row_count * width]             written: red, green, blue, and 255 where something is hit
// hits[row_count * width]                written: t in local units
//
// HAS_CUT: see cl/world/cut.cl. HAS_WIREFRAME: see cl/film/wireframe.cl.
//
// Work-items: (width, row_count), rounded up to tiles.

#include "film/section.cl"
#include "film/wireframe.cl"
#include "rays/batch.cl"
#include "shading/shade.cl"
#include "shading/shadow.cl"
#include "world/camera.cl"
#include "world/cut.cl"

// In pixels: a pixel shows a line as far as the line covers it.
#define LINE_SMOOTHING 1.0f

INLINED float3 find_colour(const global view_t *view, const global float *instance_colours, const int instance_id)
{
    const global float *own = instance_colours + 4 * instance_id;
    return load3(own[3] > 0.0f ? own : view->surface_colour);
}

kernel void render(
    WORLD_ARGUMENTS, const global tile_t *restrict tiles, const global node_t *restrict entry_points,
    const global float *restrict instance_colours, const global uchar *restrict closed,
    const global view_t *restrict view, const int first_row, const int row_count, global uchar4 *restrict colours,
    global kept_hit_t *restrict hits)
{
    const int column = get_global_id(0);
    const int band_row = get_global_id(1);
    if (column >= view->width || band_row >= row_count) {
        return;
    }
    const int pixel = band_row * view->width + column;
    const int row = first_row + band_row;
    const world_t world = WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX));

    world_ray_t ray;
    const bool is_seen = world_camera_ray(view, pixel_centre(view, column, row), LENS_CENTRE, &ray);
    search_t search = make_search(1, 0);
    if (is_seen) {
        traverse_shown(&world, view, &ray, true, true, &search);
    }
    const bool is_hit = is_found(&search.nearest);
    hits[pixel] = as_kept_hit(&search, &search.nearest);

    float3 colour;
    if (is_hit) {
        const world_surface_t surface = world_surface_at(&world, &ray, &search);
        const bool is_lit = sees_light(view, &world, &surface);
        const float3 own_colour = find_colour(view, instance_colours, surface.instance_id);
        colour = shade_surface(view, own_colour, surface.position, surface.normal, is_lit);
#if HAS_WIREFRAME
        const float2 film = pixel_centre(view, column, row);
        const float share = find_line_share(view, &world, &ray, film, &search, surface.position, LINE_SMOOTHING);
        colour = blend(colour, load3(view->line_colour), share);
#endif
#if HAS_CUT
        if (shows_section(view, closed, &world, &ray, &search)) {
            colour = section_colour(view, column, row);
        }
#endif
    } else {
        colour = is_seen ? shade_background(view, row) : (float3)(0.0f);
    }
    colours[pixel] = as_pixel(colour, is_hit);
}
