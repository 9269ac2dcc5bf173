// Adds samples of cells to a film of pixels, see film/cells.cl.
//
// samples[sample_count * cells]  float4: the light of each sample of (row_count + 2) * (width + 2) cells, one sample
//                                after the other
// width, row_count               pixels of the film
// first_sample, sample_count     samples to add, by their numbers
// is_apart                       1: each pixel has the samples of its own cell alone, and noise of its own
// settled[tiles]                 see settle_tiles.cl; NULL, as are sums and counts, where all cells have the same
//                                samples
// tile_width, tile_height        cells of a tile
// sums[cells]                    float4, added to: the samples of a cell
// counts[row_count * width]      written: samples of the pixel
// film[row_count * width]        float4, added to: linear red, green, blue, and the share that is covered
//
// Work-items: cells, rounded up to tiles. Samples are added one by one, so that the film does not depend on how many
// there are in a launch.

// keep: forbids contraction
#include "math/numeric.cl"
#include "sampling/pattern.cl"

typedef struct {
    const global float4 *light;  // of one sample
    const global float4 *sums;
    const global int *settled;
    int columns;                 // of cells
    int tile_columns, tile_width, tile_height;
} cells_t;

// The samples after which the tile of a cell was settled, or 0.
INLINED int find_settled(const cells_t *cells, const int column, const int row)
{
    return cells->settled ? cells->settled[row / cells->tile_height * cells->tile_columns + column / cells->tile_width]
                          : 0;
}

// The light of a cell: a settled one has the mean of its samples from then on.
INLINED float4 light_of(const cells_t *cells, const int column, const int row)
{
    const int cell = row * cells->columns + column;
    const int count = find_settled(cells, column, row);
    return count ? cells->sums[cell] / (float)count : cells->light[cell];
}

// Whether no cell around a pixel gets more samples.
INLINED bool is_finished(const cells_t *cells, const int column, const int row)
{
    for (int down = -1; down <= 1; down++) {
        for (int right = -1; right <= 1; right++) {
            if (!find_settled(cells, column + right, row + down)) {
                return false;
            }
        }
    }
    return true;
}

kernel void add_samples(
    const global float4 *restrict samples, const int width, const int row_count, const int first_sample,
    const int sample_count, const int is_apart, const global int *restrict settled, const int tile_width,
    const int tile_height, global float4 *sums, global int *restrict counts, global float4 *restrict film)
{
    const int column = get_global_id(0);
    const int row = get_global_id(1);
    const int columns = width + 2;
    if (column >= columns || row >= row_count + 2) {
        return;
    }
    const int cell = row * columns + column;
    const int cell_count = columns * (row_count + 2);
    cells_t cells = {samples, sums, settled, columns, (columns - 1) / tile_width + 1, tile_width, tile_height};
    if (settled && !find_settled(&cells, column, row)) {
        float4 sum = first_sample == 0 ? (float4)(0.0f) : sums[cell];
        for (int sample = 0; sample < sample_count; sample++) {
            sum += samples[sample * cell_count + cell];
        }
        sums[cell] = sum;
    }
    const bool is_inside = column > 0 && column <= width && row > 0 && row <= row_count;
    if (!is_inside || is_finished(&cells, column, row)) {
        return;
    }
    const int pixel = (row - 1) * width + column - 1;
    float4 sum = first_sample == 0 ? (float4)(0.0f) : film[pixel];
    for (int sample = 0; sample < sample_count; sample++) {
        cells.light = samples + sample * cell_count;
        if (is_apart) {
            sum += light_of(&cells, column, row);
            continue;
        }
        // A sample to the left of its cell's centre counts for the pixel of the cell and for the one to the left of it:
        // this pixel gets it from its own cell, and from the one to the right.
        const float2 offset = find_offset(first_sample + sample);
        const int other_column = offset.x < 0.0f ? column + 1 : column - 1;
        const int other_row = offset.y < 0.0f ? row + 1 : row - 1;
        const float2 share = offset < 0.0f ? -offset : offset;
        sum += (1.0f - share.x) * (1.0f - share.y) * light_of(&cells, column, row);
        sum += share.x * (1.0f - share.y) * light_of(&cells, other_column, row);
        sum += (1.0f - share.x) * share.y * light_of(&cells, column, other_row);
        sum += share.x * share.y * light_of(&cells, other_column, other_row);
    }
    film[pixel] = sum;
    if (settled) {
        counts[pixel] = first_sample + sample_count;
    }
}
