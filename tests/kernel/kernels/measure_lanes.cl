// distance_squared_to_triangle for WIDTH triangles in lanes.
//
// corners[9 * WIDTH * count]     float [count][3][3][WIDTH]: each coordinate of each corner of WIDTH triangles
// squares[WIDTH * count]         written: squared distance of each from zero

#include "traversal/traverse.cl"
#include "nearest/point_triangle.cl"

INLINED point_t load_points(const global float *from)
{
    const point_t points = {load_lanes(from), load_lanes(from + WIDTH), load_lanes(from + 2 * WIDTH)};
    return points;
}

kernel void measure_lanes(
    const global float *restrict corners, global float *restrict squares, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const global float *block = corners + 9 * WIDTH * i;
    ((global lanes_t *)squares)[i] = distance_squared_to_triangle(
        load_points(block), load_points(block + 3 * WIDTH), load_points(block + 6 * WIDTH));
}
