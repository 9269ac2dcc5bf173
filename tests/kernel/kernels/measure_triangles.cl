// distance_squared_to_triangle for a single triangle.
//
// corners[9 * count]     float: three corners of each triangle
// squares[count]         written: squared distance of each from zero

#include "nearest/point_triangle.cl"

INLINED point_t load_point(const global float *from)
{
    const point_t point = {from[0], from[1], from[2]};
    return point;
}

kernel void measure_triangles(
    const global float *restrict corners, global float *restrict squares, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    squares[i] = distance_squared_to_triangle(
        load_point(corners + 9 * i), load_point(corners + 9 * i + 3), load_point(corners + 9 * i + 6));
}
