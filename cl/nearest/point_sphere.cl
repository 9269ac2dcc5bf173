// The distance of a sphere's surface from zero: of a single one, or, if WIDTH is defined, of WIDTH spheres in lanes.
// Both are the same arithmetic with the same bits.

#include "nearest/point_triangle.cl"

// Inside, the surface is as far as the radius is longer than the distance from the centre.
INLINED real_t distance_squared_to_sphere(const point_t centre, const real_t radius)
{
    const real_t height = sqrt(dot_of(centre, centre)) - radius;
    return height * height;
}
