// distance_squared_to_ellipsoid, by row.
//
// positions[3 * count]     float: not negative
// lengths[3 * count]       float: half lengths of the axes
// squares[count]           written: squared distance of each position from the ellipsoid around zero

#include "nearest/ellipsoid.cl"

kernel void measure_ellipsoids(
    const global float *restrict positions, const global float *restrict lengths, global float *restrict squares,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    squares[i] = distance_squared_to_ellipsoid(vload3(i, positions), vload3(i, lengths));
}
