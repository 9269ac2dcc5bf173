// The tiles of cells that need no more samples, see film/cells.cl. A tile is a work-group of render_samples.
//
// Passes end after SETTLING_SAMPLES samples, twice, four times, eight times as many, ... The mean light of a cell
// changes from one pass to the next by about the noise that the new mean has; the noise of a tile is the root mean
// square over its cells.
//
// sums[cells]              see add_samples.cl
// view[1], row_count       the picture, and its rows in this band
// tile_width, tile_height  cells of a tile
// sample_count             samples of the tiles that are not settled: a pass has ended
// noise                    a tile with less noise, as a share of its light, is settled
// lights[cells]            light of each cell: after the pass before, and then after this one
// settled[tiles]           written: 0, or the samples after which the tile was settled
//
// Work-items: tiles, columns and rows.

// keep: forbids contraction
#include "math/numeric.cl"
#include "film/luminance.cl"
#include "structs.cl"

// Light of a picture below which noise is hardly seen: noise counts relative to the tile's light and this.
#define DIM_LIGHT 0.1f

kernel void settle_tiles(
    const global float4 *restrict sums, const global view_t *restrict view, const int row_count, const int tile_width,
    const int tile_height, const int sample_count, const float noise, global float *restrict lights,
    global int *restrict settled)
{
    const int columns = view->width + 2;
    const int first_column = get_global_id(0) * tile_width;
    const int first_row = get_global_id(1) * tile_height;
    const int tile = get_global_id(1) * get_global_size(0) + get_global_id(0);
    if (settled[tile]) {
        return;
    }
    float light = 0.0f;
    float change = 0.0f;
    int count = 0;
    for (int row = first_row; row < min(first_row + tile_height, row_count + 2); row++) {
        for (int column = first_column; column < min(first_column + tile_width, columns); column++) {
            const int cell = row * columns + column;
            const float found = view->exposure * luminance(sums[cell].xyz) / sample_count;
            const float difference = found - lights[cell];
            light += found;
            change += difference * difference;
            lights[cell] = found;
            count++;
        }
    }
    const float bound = noise * (light / count + DIM_LIGHT);
    if (sample_count > SETTLING_SAMPLES && change < count * bound * bound) {
        settled[tile] = sample_count;
    }
}
