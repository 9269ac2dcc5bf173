// A film by pixels from a film by cells, see film/cells.cl.
//
// cells[(row_count + 2) * (width + 2)]  CELL_PIXELS float4 each: weighted sums of samples
// width, row_count                      pixels of the film
// is_apart                              1: each pixel has the samples of its own cell alone, and noise of its own
// film[row_count * width]               float4, written: sums of linear red, green, blue, and of the share that is
//                                       covered
//
// Work-items: (width, row_count), rounded up to tiles.

#include "structs.cl"
// keep: forbids contraction
#include "math/numeric.cl"

kernel void join_cells(
    const global float4 *restrict cells, const int width, const int row_count, const int is_apart,
    global float4 *restrict film)
{
    const int column = get_global_id(0);
    const int row = get_global_id(1);
    if (column >= width || row >= row_count) {
        return;
    }
    // The pixel is the last one of the first of these cells, and the first one of the last.
    float4 sum = (float4)(0.0f);
    for (int down = 0; down < 3; down++) {
        for (int right = 0; right < 3; right++) {
            // The weights of a sample add up to 1, and so do the sums of its cell.
            const int cell = is_apart ? (row + 1) * (width + 2) + column + 1
                                      : (row + down) * (width + 2) + column + right;
            sum += cells[CELL_PIXELS * cell + CELL_PIXELS - 1 - (3 * down + right)];
        }
    }
    film[row * width + column] = sum;
}
