// The closest point of a triangle to zero, in float64. cl/nearest/point_triangle.cl has it in float32.

#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A point of a triangle: the weights of the corners, and its squared distance from zero.
typedef struct {
    double3 weights;
    double squared;
} triangle_point_t;

// Keeps an edge's closest point if it is closer than the one before. Its weights are at two of the corners.
INLINED void try_edge(
    const double3 begin, const double3 end, const int begin_corner, const int end_corner, triangle_point_t *closest)
{
    const double3 way = end - begin;
    const double share = -dot3(begin, way) / dot3(way, way);
    const double along = share > 0.0 ? least_of(share, 1.0) : 0.0;  // NaN of an edge without length is none
    const double3 point = begin + along * way;
    const double squared = dot3(point, point);
    if (squared >= closest->squared) {
        return;
    }
    closest->weights = (double3)(0.0);
    closest->weights[begin_corner] = 1.0 - along;
    closest->weights[end_corner] = along;
    closest->squared = squared;
}

// Keeps the foot of the perpendicular if it is in the triangle, and closer than the point before.
INLINED void try_inside(const double3 a, const double3 b, const double3 c, triangle_point_t *closest)
{
    const double3 normal = cross3(b - a, c - a);
    const double3 weights = (double3)(
        dot3(normal, cross3(b, c)), dot3(normal, cross3(c, a)), dot3(normal, cross3(a, b)));
    const double total = weights.x + weights.y + weights.z;
    if (!(weights.x >= 0.0 && weights.y >= 0.0 && weights.z >= 0.0 && total > 0.0)) {
        return;
    }
    // The plane's distance along its normal: better than the weighted sum of corners, which cancel.
    const double along = dot3(a, normal);
    const double squared = along * along / dot3(normal, normal);
    if (!(squared >= closest->squared)) {
        closest->weights = weights / total;
        closest->squared = squared;
    }
}

INLINED triangle_point_t closest_on_triangle(const double3 a, const double3 b, const double3 c)
{
    triangle_point_t closest = {(double3)(0.0), INFINITY};
    try_edge(a, b, 0, 1, &closest);
    try_edge(b, c, 1, 2, &closest);
    try_edge(c, a, 2, 0, &closest);
    try_inside(a, b, c, &closest);
    return closest;
}
