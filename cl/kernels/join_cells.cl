// A film by pixels from a film by cells, see film/cells.cl.
//
// cells[(row_count + 2) * (width + 2)]  CELL_PIXELS float4 each: weighted sums of samples
// width, row_count                      pixels of the film
// is_apart                              1: each pixel has the samples of its own cell alone, and noise of its own
// settled[], weights[]                  see settle_tiles.cl; NULL where all cells have the same samples
// tile_width, tile_height               cells of a tile
// sample_count                          samples of the tiles that were not settled
// film[row_count * width]               float4, written: sums of linear red, green, blue, and of the share that is
//                                       covered; means where tiles were settled
//
// Work-items: (width, row_count), rounded up to tiles.

#include "structs.cl"
// keep: forbids contraction
#include "math/numeric.cl"

kernel void join_cells(
    const global float4 *restrict cells, const int width, const int row_count, const int is_apart,
    const global int *restrict settled, const global float *restrict weights, const int tile_width,
    const int tile_height, const int sample_count, global float4 *restrict film)
{
    const int column = get_global_id(0);
    const int row = get_global_id(1);
    if (column >= width || row >= row_count) {
        return;
    }
    const int tile_columns = (width + 1) / tile_width + 1;
    // The pixel is the last one of the first of these cells, and the first one of the last.
    float4 sum = (float4)(0.0f);
    float white = 0.0f;
    for (int down = 0; down < 3; down++) {
        for (int right = 0; right < 3; right++) {
            // The weights of a sample add up to 1, and so do the sums of its cell.
            const int cell_row = is_apart ? row + 1 : row + down;
            const int cell_column = is_apart ? column + 1 : column + right;
            const int pixel = CELL_PIXELS - 1 - (3 * down + right);
            const float4 light = cells[CELL_PIXELS * (cell_row * (width + 2) + cell_column) + pixel];
            if (settled) {
                const int pass = settled[cell_row / tile_height * tile_columns + cell_column / tile_width];
                sum += light / (float)(pass ? SETTLING_SAMPLES << pass : sample_count);
                white += weights[CELL_PIXELS * pass + pixel];
            } else {
                sum += light;
            }
        }
    }
    film[row * width + column] = settled ? sum / white : sum;
}
