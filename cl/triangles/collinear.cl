// Triangles without an area.

// keep: no contraction
#include "math/numeric.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// Whether three points lie on one line, or in one point. Differences of float32 values and their products fit float64,
// so collinear means equal products; of float64 values as far as they have no more digits.
INLINED bool is_collinear(const double3 a, const double3 b, const double3 c)
{
    const double3 u = b - a;
    const double3 v = c - a;
    return u.y * v.z == u.z * v.y && u.z * v.x == u.x * v.z && u.x * v.y == u.y * v.x;
}
