// Films by cells: the square of each pixel, whose samples count for the 3 x 3 pixels around it by the tent filter. So a
// pixel has the samples of nine cells, and the noise of about twice as many samples that are drawn by the filter and
// count for it alone.
//
// All cells have the same pattern of samples, so the weights of a pixel's samples add up to their number, and edges
// have no noise. Sample 0 is the centre of the pixel.
//
// Cell (column, row) belongs to the pixel (column - 1, row - 1): there are cells around the picture, too.

#include "sampling/pattern.cl"
#include "structs.cl"

// Sums of samples, weighted for each of CELL_PIXELS pixels: from the upper left one, row by row.
typedef struct {
    float4 sums[CELL_PIXELS];
} cell_t;

// Where a sample is from the centre of its pixel, -0.5 to 0.5 in each direction.
INLINED float2 find_offset(const uint sample)
{
    return pattern_point(sample) - 0.5f;
}

// The first pixel of a pair for which samples at an offset count: 0 and 1, or 1 and 2.
INLINED int first_of_pair(const float offset)
{
    return offset < 0.0f ? 0 : 1;
}

// The weight of the second pixel of the pair; the first has the rest.
INLINED float second_weight(const float offset)
{
    return offset < 0.0f ? 1.0f + offset : offset;
}

INLINED void add_to_cell(cell_t *cell, const float2 offset, const float4 light)
{
    float4 *sums = cell->sums + 3 * first_of_pair(offset.y) + first_of_pair(offset.x);
    const float right = second_weight(offset.x);
    const float below = second_weight(offset.y);
    sums[0] += (1.0f - right) * (1.0f - below) * light;
    sums[1] += right * (1.0f - below) * light;
    sums[3] += (1.0f - right) * below * light;
    sums[4] += right * below * light;
}

INLINED cell_t load_cell(const global float4 *film, const int index, const bool is_new)
{
    cell_t cell;
    for (int pixel = 0; pixel < CELL_PIXELS; pixel++) {
        cell.sums[pixel] = is_new ? (float4)(0.0f) : film[CELL_PIXELS * index + pixel];
    }
    return cell;
}

INLINED void store_cell(const cell_t *cell, global float4 *film, const int index)
{
    for (int pixel = 0; pixel < CELL_PIXELS; pixel++) {
        film[CELL_PIXELS * index + pixel] = cell->sums[pixel];
    }
}
