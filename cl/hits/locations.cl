// Locations and normals of points on primitives, in double.
//
// A location is computed in the object and then placed, so a shared edge of two triangles is one line in the world,
// too.

#include "structs.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "spheres/crossing.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A normal is not used if the corners of its triangle differ by more than this in height, in local units: sixteen
// roundings of float.
#define MOST_TILT 0x1p-20

// A unit vector and the length of what it was made of; NaN for one of length zero.
typedef struct {
    double3 unit;
    double length;
} direction_t;

INLINED direction_t direction_of(const double3 v)
{
    // Divided by the largest component first: the squares of a small triangle's normal could underflow.
    const double largest = largest_size(v);
    const double3 scaled = v / largest;
    const double length = sqrt(dot3(scaled, scaled));
    const direction_t direction = {scaled / length, length * largest};
    return direction;
}

// A unit vector at right angles to the longest edge of a triangle; NaN if all edges have length zero.
INLINED double3 across_longest_edge(const wide_corners_t *corners)
{
    const double3 ways[3] = {corners->b - corners->a, corners->c - corners->b, corners->a - corners->c};
    double longest = 0.0;
    double3 edge = (double3)(0.0);
    for (int side = 0; side < 3; side++) {
        if (largest_size(ways[side]) > longest) {
            longest = largest_size(ways[side]);
            edge = ways[side];
        }
    }
    edge = direction_of(edge).unit;
    // The axis that is most across the edge, less its share along it.
    const double3 size = fabs(edge);
    double3 axis = (double3)(1.0, 0.0, 0.0);
    double share = edge.x;
    if (size.y < fabs(share)) {
        axis = (double3)(0.0, 1.0, 0.0);
        share = edge.y;
    }
    if (size.z < fabs(share)) {
        axis = (double3)(0.0, 0.0, 1.0);
        share = edge.z;
    }
    const double3 across = axis - share * edge;
    return across / sqrt(dot3(across, across));
}

// The unit normal of a triangle on the side from which its corners run anticlockwise. A triangle so thin that double
// does not know its normal gets a vector across its longest edge.
INLINED double3 normal_of(const wide_corners_t *corners, const double scale)
{
    const double3 ab = (corners->b - corners->a) * scale, ac = (corners->c - corners->a) * scale;
    const double3 normal = direction_of(cross3(ab, ac)).unit;
    // Written so that NaN is a tilt: how much higher one corner is than another one along the normal.
    const bool is_upright = fabs(dot3(ab, normal)) + fabs(dot3(ac, normal)) <= MOST_TILT;
    return is_upright ? normal : across_longest_edge(corners);
}

// The point (u, v) of a triangle.
INLINED double3 point_on(const wide_corners_t *corners, const double u, const double v)
{
    return corners->a + (u * (corners->b - corners->a) + v * (corners->c - corners->a));
}

// The point (u, v) of a primitive, in the world's coordinates.
INLINED double3 locate_point(
    const surfaces_t *surfaces, const int instance, const int prim, const double u, const double v)
{
    const int geometry = surfaces->geometry_id[instance];
    double3 point;
    if (IS_SPHERES(surfaces->kind[geometry])) {
        const global double *sphere = sphere_at(surfaces, geometry, prim);
        point = load_wide_row(sphere, 0) + sphere[3] * sphere_point(u, v);
    } else {
        const wide_corners_t corners = load_wide_corners(surfaces, geometry, prim);
        point = point_on(&corners, u, v);
    }
    return surfaces->is_lone
        ? point : multiply(surfaces->linear, instance, point) + load_wide_row(surfaces->offset, instance);
}

// The unit vector along the inverse transpose of an instance's linear part times a vector of its object; and the length
// of that product: the way in the object, along its vector, for a unit of the way in the world. A lone shape's vector
// stays as it is.
//
// Lengths of tangents and of normals change by inverse factors, so the transform itself would tilt normals. The inverse
// transpose keeps their sides: its product with the transform of a vector d is that of the object's normal with d.
INLINED direction_t turn_normal(const surfaces_t *surfaces, const int instance, const double3 normal)
{
    if (surfaces->is_lone) {
        const direction_t same = {normal, 1.0};
        return same;
    }
    const global double *rows = surfaces->inverse + 9 * (long)instance;
    return direction_of(
        load_wide_row(rows, 0) * normal.x + load_wide_row(rows, 1) * normal.y + load_wide_row(rows, 2) * normal.z);
}

// The unit normal at the point (u, v) of a primitive, on its outer side, in the world.
INLINED double3 normal_at_point(
    const surfaces_t *surfaces, const int instance, const int prim, const double u, const double v)
{
    const int geometry = surfaces->geometry_id[instance];
    double3 normal;
    if (IS_SPHERES(surfaces->kind[geometry])) {
        normal = sphere_point(u, v);
    } else {
        const wide_corners_t corners = load_wide_corners(surfaces, geometry, prim);
        normal = normal_of(&corners, surfaces->scale[geometry]);
    }
    return turn_normal(surfaces, instance, normal).unit;
}
