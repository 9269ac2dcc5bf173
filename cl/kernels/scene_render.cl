// A band of rows of a picture of a scene: the closest hit and the colour of each pixel.
//
// Shared arguments: see cl/instances/traverse.cl.
// view[1]                                view_t: camera, light and colours, see clbvh/structs.py
// instance_colours[4 * instance_count]   by instance_id: linear red, green, blue, and whether the instance has a colour
//                                        of its own, 0 or 1; without, it has that of the view
// first_row, row_count                   rows of the picture in this band; row 0 is the top
// colours[row_count * width]             written: red, green, blue, and 255 where something is hit
// hits[row_count * width]                written: t in local units
//
// Work-items: (width, row_count), rounded up to work-groups.

#include "instances/camera.cl"
#include "instances/shadow.cl"
#include "instances/start.cl"
#include "instances/surface.cl"
#include "instances/traverse.cl"
#include "shading/shade.cl"

INLINED float3 find_colour(const global view_t *view, const global float *instance_colours, const int instance_id)
{
    const global float *own = instance_colours + 4 * instance_id;
    return load3(own[3] > 0.0f ? own : view->surface_colour);
}

kernel void scene_render(
    const global bvh2_node_t *restrict top_nodes, const global instance_t *restrict instances,
    const global node_t *restrict nodes, const global block_t *restrict blocks, const global float *restrict spheres,
    const global float *restrict instance_colours, const global view_t *restrict view, const int first_row,
    const int row_count, global uchar4 *restrict colours, global scene_hit_t *restrict hits)
{
    const int column = get_global_id(0);
    const int band_row = get_global_id(1);
    if (column >= view->width || band_row >= row_count) {
        return;
    }
    const int pixel = band_row * view->width + column;
    const int row = first_row + band_row;

    const scene_ray_pair_t ray = scene_primary_ray(view, column, row);
    search_t search = make_search(1, 0);
    const scene_start_t root = start_at_root();
    traverse_scene(top_nodes, instances, nodes, blocks, spheres, root, &ray, &search, QUERY_CLOSEST);
    const bool is_hit = is_found(&search.nearest);
    hits[pixel] = as_kept_hit(&search, &search.nearest);

    float3 colour;
    if (is_hit) {
        const placed_surface_t surface = scene_surface_at(instances, blocks, spheres, &ray, &search);
        const bool is_lit = sees_light_in_scene(view, &surface, top_nodes, instances, nodes, blocks, spheres);
        const float3 own_colour = find_colour(view, instance_colours, search.instance_id);
        colour = shade_surface(view, own_colour, surface.above, surface.normal, is_lit);
    } else {
        colour = has_range(ray.t_max) ? shade_background(view, row) : (float3)(0.0f);
    }
    colours[pixel] = as_pixel(colour, is_hit);
}
