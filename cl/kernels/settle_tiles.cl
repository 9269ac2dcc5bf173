// The tiles of a film by cells that need no more samples, see film/cells.cl. A tile is a work-group of render_samples.
//
// Passes end after SETTLING_SAMPLES samples, twice, four times, eight times as many, ... The mean light of a cell
// changes from one pass to the next by about the noise that the new mean has; the noise of a tile is the root mean
// square over its cells.

// keep: forbids contraction
#include "math/numeric.cl"
#include "film/cells.cl"
#include "film/luminance.cl"

// Light of a picture below which noise is hardly seen: noise counts relative to the tile's light and this.
#define DIM_LIGHT 0.1f

INLINED float mean_light(const global float4 *cell)
{
    float4 sum = (float4)(0.0f);
    for (int pixel = 0; pixel < CELL_PIXELS; pixel++) {
        sum += cell[pixel];
    }
    return luminance(sum.xyz);
}

// cells[], view[1], row_count   see render_samples.cl and join_cells.cl
// tile_width, tile_height       cells of a tile
// pass                          number of the pass that has ended, from 0
// noise                         a tile with less noise, as a share of its light, is settled
// lights[cells]                 mean light of each cell: after the pass before, and then after this one
// settled[tiles]                0, or the pass after which the tile was settled; written
//
// Work-items: tiles, columns and rows.
kernel void settle_tiles(
    const global float4 *restrict cells, const global view_t *restrict view, const int row_count, const int tile_width,
    const int tile_height, const int pass, const float noise, global float *restrict lights,
    global int *restrict settled)
{
    const int columns = view->width + 2;
    const int first_column = get_global_id(0) * tile_width;
    const int first_row = get_global_id(1) * tile_height;
    const int tile = get_global_id(1) * get_global_size(0) + get_global_id(0);
    if (settled[tile]) {
        return;
    }
    const float scale = view->exposure / (float)(SETTLING_SAMPLES << pass);
    float light = 0.0f;
    float change = 0.0f;
    int count = 0;
    for (int row = first_row; row < min(first_row + tile_height, row_count + 2); row++) {
        for (int column = first_column; column < min(first_column + tile_width, columns); column++) {
            const int cell = row * columns + column;
            const float found = scale * mean_light(cells + CELL_PIXELS * cell);
            const float difference = found - lights[cell];
            light += found;
            change += difference * difference;
            lights[cell] = found;
            count++;
        }
    }
    const float bound = noise * (light / count + DIM_LIGHT);
    if (pass > 0 && change < count * bound * bound) {
        settled[tile] = pass;
    }
}

// What white light leaves in a cell, in the mean of the samples: row by row those of a tile that was settled after a
// pass, and in row 0 those of the tiles that were not.
//
// sample_count  samples of the tiles that were not settled
// weights[]     written: CELL_PIXELS of them a row
//
// Work-items: rows.
kernel void weigh_samples(const int sample_count, global float *restrict weights)
{
    const int row = get_global_id(0);
    const int count = row == 0 ? sample_count : SETTLING_SAMPLES << row;
    cell_t cell = {{(float4)(0.0f)}};
    for (int sample = 0; sample < count; sample++) {
        add_to_cell(&cell, find_offset(sample), (float4)(1.0f));
    }
    for (int pixel = 0; pixel < CELL_PIXELS; pixel++) {
        weights[CELL_PIXELS * row + pixel] = cell.sums[pixel].x / count;
    }
}
