// Samples of a band of rows of a picture. Those of pixels are added to its film; those of cells, for SHADE_PATH, wait
// for add_samples.cl, see film/cells.cl.
//
// Shared arguments: see cl/world/world.cl, cl/looks/looks.cl and cl/traversal/entry_point.cl.
// lights[] and so on          see cl/film/lights.cl; NULL but for SHADE_PATH
// closed[instance_count]      by instance_id: whether it encloses a volume; NULL without a cut
// view[1]                     view_t: camera, light and colours, see clbvh/structs.py
// first_row, row_count        rows of the picture in this band; row 0 is the top
// first_sample, sample_count  samples to take of each pixel, by their numbers
// settled[]                   tiles that get no more samples, see settle_tiles.cl; NULL but for SHADE_PATH with noise
// film[row_count * width]     float4, added to: linear red, green, blue, and the share that is covered. For SHADE_PATH,
//                             written: each sample, as add_samples.cl reads them
// hits[row_count * width]     written with sample 0, which is the centre of the pixel: t in local units
//
// SHADING: the shading's number, one of SHADE_STUDIO, SHADE_AO, SHADE_ALBEDO and SHADE_PATH. HAS_CUTOUTS: see
// film/stage.cl. HAS_CUT: see world/cut.cl. HAS_WIREFRAME: see film/wireframe.cl. HAS_GROUND: see film/path.cl.
//
// Work-items: (width, row_count), or cells, rounded up to tiles. The samples of a pixel are added one by one, in the
// order of their numbers, so that the film does not depend on bands or on how many samples a launch takes.

#ifndef SHADING
#define SHADING SHADE_STUDIO
#endif

// keep: files that several shadings include are expanded before the branches
#include "film/ground.cl"
#include "film/openness.cl"
#include "film/pixel.cl"
#include "film/section.cl"
#include "film/wireframe.cl"
#include "rays/batch.cl"
#include "sampling/screen.cl"
#include "traversal/entry_point.cl"
#if SHADING == SHADE_PATH
#include "film/cells.cl"
#include "film/path.cl"
#elif SHADING == SHADE_AO
#include "film/ao.cl"
#elif SHADING == SHADE_ALBEDO
#include "film/albedo.cl"
#else
#include "film/studio.cl"
#endif

#if HAS_WIREFRAME

// Samples are spread over two pixels: the sides of lines need little more.
#define LINE_SMOOTHING 0.5f

// The light of a sample with the lines on the surface that it shows.
INLINED float3 draw_lines(
    const stage_t *stage, const world_ray_t *ray, const float2 film, const search_t *shown, const float3 light)
{
    if (!is_found(&shown->nearest)) {
        return light;
    }
    const world_surface_t surface = world_surface_at(&stage->world, ray, shown);
    const float share =
        find_line_share(stage->view, &stage->world, ray, film, shown, surface.position, LINE_SMOOTHING);
    return blend(light, load3(stage->view->line_colour), share);
}

#endif

kernel void render_samples(
    WORLD_ARGUMENTS, const global tile_t *restrict tiles, const global node_t *restrict entry_points,
    const global look_t *restrict looks, const global uint *restrict corner_normals,
    const global uint *restrict corner_colours, const global float *restrict corner_uvs,
    const global int *restrict material_ids, const global material_t *restrict materials,
    const global texture_t *restrict textures, const global uint *restrict texels,
    const global float *restrict decoded_srgb, const global light_t *restrict lights,
    const global light_choice_t *restrict light_choices, const global float *restrict environment,
    const global float *restrict environment_rows, const global float *restrict environment_columns,
    const global uchar *restrict closed, const global view_t *restrict view, const int first_row,
    const int row_count, const int first_sample, const int sample_count, const global int *restrict settled,
    global float4 *restrict film, global kept_hit_t *restrict hits)
{
    const int column = get_global_id(0);
    const int band_row = get_global_id(1);
#if SHADING == SHADE_PATH
    const int width = view->width + 2;
    if (column >= width || band_row >= row_count + 2) {
        return;
    }
    if (settled && settled[TILE_INDEX]) {
        return;
    }
#else
    const int width = view->width;
    if (column >= width || band_row >= row_count) {
        return;
    }
#endif
    const int pixel = band_row * width + column;
    const int row = first_row + band_row;
    const stage_t stage = {
        WORLD(find_start(nodes, tiles, entry_points, TILE_INDEX)),
        {looks, corner_normals, corner_colours, corner_uvs, material_ids, materials,
         {textures, texels, decoded_srgb}, view->surface_colour},
        view};

#if SHADING == SHADE_PATH
    const lights_t light_tables = {lights, light_choices, environment, environment_rows, environment_columns};
    for (int sample = first_sample; sample < first_sample + sample_count; sample++) {
        const float2 offset = find_offset(sample);
        world_ray_t ray;
        float4 value = (float4)(0.0f);
        ray_hits_t ray_hits = make_ray_hits();
        sobol_sampler_t sampler = make_sampler(row * width + column, sample, view->seed);
        if (sample_cell(view, column, row, offset, sample, &ray)) {
            value = find_path_sample(&stage, &light_tables, &ray, row - 1, &sampler, &ray_hits);
#if HAS_WIREFRAME
            const float2 point = film_point(view, column - 1, row - 1, offset);
            value.xyz = draw_lines(&stage, &ray, point, &ray_hits.shown, value.xyz);
#endif
#if HAS_CUT
            if (shows_section(view, closed, &stage.world, &ray, &ray_hits.first)) {
                value = (float4)(section_colour(view, column, row), 1.0f);
            }
#endif
        }
        film[(sample - first_sample) * width * (row_count + 2) + pixel] = value;
        const bool is_inside = column > 0 && column <= view->width && band_row > 0 && band_row <= row_count;
        if (sample == 0 && is_inside) {
            hits[(band_row - 1) * view->width + column - 1] = as_kept_hit(&ray_hits.first, &ray_hits.first.nearest);
        }
    }
#else
#if SHADING == SHADE_STUDIO
    known_light_t light;
#endif
    float4 sum = first_sample == 0 ? (float4)(0.0f) : film[pixel];
    for (int sample = first_sample; sample < first_sample + sample_count; sample++) {
        world_ray_t ray;
        float4 value = (float4)(0.0f);
        ray_hits_t ray_hits = make_ray_hits();
        const bool is_seen = sample_pixel(view, column, row, sample, &ray);
#if SHADING == SHADE_STUDIO
        // Two samples share what they know of the light, and one point for it.
        if ((sample & 1) == 0 || sample == first_sample) {
            light.is_known = false;
        }
        sobol_sampler_t sampler = make_screen_sampler(column, row, sample >> 1, view->seed);
        // But each has its own chance to pass through a surface.
        sobol_sampler_t layers = make_screen_sampler(column, row, sample, ~view->seed);
        if (is_seen) {
            value = find_studio_sample(&stage, &ray, row, &layers, &sampler, &light, &ray_hits);
        }
#else
        sobol_sampler_t sampler = make_screen_sampler(column, row, sample, view->seed);
        if (is_seen) {
            value = find_sample(&stage, &ray, row, &sampler, &ray_hits);
        }
#endif
#if HAS_WIREFRAME
        value.xyz = draw_lines(&stage, &ray, sample_film(view, column, row, sample), &ray_hits.shown, value.xyz);
#endif
#if HAS_CUT
        if (is_seen && shows_section(view, closed, &stage.world, &ray, &ray_hits.first)) {
            value = (float4)(section_colour(view, column, row), 1.0f);
        }
#endif
        sum += value;
        if (sample == 0) {
            hits[pixel] = as_kept_hit(&ray_hits.first, &ray_hits.first.nearest);
        }
    }
    film[pixel] = sum;
#endif
}
