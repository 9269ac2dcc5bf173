// Whether primitives meet upright boxes, in double, by clbvh/trace/points/queries.py.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/surfaces.cl"
#include "nearest/refine.cl"
#include "math/doubles.cl"
#include "triangles/closest.cl"

// What a box is surely apart by: roundings of coordinates, and of their products along an axis.
#define COORDINATE_ROOM 0x1p-50
#define AXIS_ROOM 0x1p-48

// Whether a triangle is surely apart from a box around zero along an axis, whose components are differences of products
// of these `sizes`. A coordinate is off by `blur` at most.
INLINED bool is_apart(
    const double3 axis, const double3 sizes, const double3 triangle[3], const double3 half_size, const double blur)
{
    const double a = dot3(axis, triangle[0]), b = dot3(axis, triangle[1]), c = dot3(axis, triangle[2]);
    const double3 farthest = fabs(triangle[0]) + fabs(triangle[1]) + fabs(triangle[2]) + half_size;
    const double reach = dot3(fabs(axis), half_size) + dot3(sizes, farthest * AXIS_ROOM + (double3)(blur));
    return least_of(least_of(a, b), c) > reach || most_of(most_of(a, b), c) < -reach;
}

// Whether the plane or an edge of a triangle separates it from a box around zero, whose axes do not.
INLINED bool is_separated(const double3 triangle[3], const double3 half_size, const double blur)
{
    const double3 edges[3] = {triangle[1] - triangle[0], triangle[2] - triangle[1], triangle[0] - triangle[2]};
    const double3 e0 = fabs(edges[0]), e1 = fabs(edges[1]);
    const double3 sizes = e0.yzx * e1.zxy + e0.zxy * e1.yzx;
    bool is_separate = is_apart(cross3(edges[0], edges[1]), sizes, triangle, half_size, blur);
    for (int edge = 0; edge < 3; edge++) {
        const double3 e = edges[edge];
        const double3 axes[3] = {
            (double3)(0.0, -e.z, e.y), (double3)(e.z, 0.0, -e.x), (double3)(-e.y, e.x, 0.0)};
        for (int row = 0; row < 3; row++) {
            is_separate |= is_apart(axes[row], fabs(axes[row]), triangle, half_size, blur);
        }
    }
    return is_separate;
}

// Whether the faces of a parallelepiped meet the ball around zero of radius 1. The number of a corner has a bit for
// each axis, set at the upper end.
INLINED bool meets_ball(const double3 corners[8])
{
    const int faces[12][3] = {
        {0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
        {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5},
    };
    double least = INFINITY;
    for (int face = 0; face < 12; face++) {
        const int *corner = faces[face];
        const triangle_point_t closest =
            closest_on_triangle(corners[corner[0]], corners[corner[1]], corners[corner[2]]);
        least = least_of(least, closest.squared);
    }
    return least <= 1.0;
}

// Whether the box from `least` to `most` meets a box.
INLINED bool meets_box(const double3 least, const double3 most, const double3 lower, const double3 upper)
{
    return least.x <= upper.x && least.y <= upper.y && least.z <= upper.z && lower.x <= most.x && lower.y <= most.y
        && lower.z <= most.z;
}

INLINED double3 least_of3(const double3 a, const double3 b)
{
    return (double3)(least_of(a.x, b.x), least_of(a.y, b.y), least_of(a.z, b.z));
}

// Whether a placed triangle meets a box. Coordinates are compared as they are, and multiplied with each other near one.
INLINED bool
meets_triangle(const double3 corners[3], const double scale, const double3 lower, const double3 upper)
{
    const double3 least = least_of3(least_of3(corners[0], corners[1]), corners[2]);
    const double3 most = -least_of3(least_of3(-corners[0], -corners[1]), -corners[2]);
    if (!meets_box(least, most, lower, upper)) {
        return false;
    }
    const double3 half_size = (upper - lower) * 0.5, middle = lower + half_size;
    const double3 seen[3] = {
        (corners[0] - middle) * scale, (corners[1] - middle) * scale, (corners[2] - middle) * scale};
    const double farthest = most_of(largest_size(least), largest_size(most)) + largest_size(half_size);
    return !is_separated(seen, half_size * scale, COORDINATE_ROOM * farthest * scale);
}

// Whether a placed sphere meets a box: in the coordinates of the sphere.
INLINED bool meets_sphere(
    const surfaces_t *surfaces, const int instance, const global double *sphere, const double3 lower,
    const double3 upper)
{
    const double3 centre = place_wide_point(surfaces, instance, load_wide_row(sphere, 0));
    double3 corners[8];
    for (int corner = 0; corner < 8; corner++) {
        const double3 end = (double3)(
            corner & 1 ? upper.x : lower.x, corner & 2 ? upper.y : lower.y, corner & 4 ? upper.z : lower.z);
        corners[corner] = multiply(surfaces->inverse, instance, end - centre) / sphere[3];
    }
    return meets_box(centre, centre, lower, upper) || meets_ball(corners);
}

// Writes whether primitives meet boxes.
//
// surfaces            `SurfaceArrays.addresses`
// box_ids, prims      the box of each, and the primitive
loop void meet_boxes(
    const ulong *surfaces, const double *lower, const double *upper, const long count, const long box_ids[count],
    const world_prim_t prims[count], bool is_met[count])
{
    const surfaces_t own = surfaces_on_host(surfaces);
    for (long row = 0; row < count; row++) {
        const double3 below = load_wide_row(lower, box_ids[row]), above = load_wide_row(upper, box_ids[row]);
        const int instance = prims[row].instance_id, prim = prims[row].prim_id, geometry = own.geometry_id[instance];
        if (IS_SPHERES(own.kind[geometry])) {
            is_met[row] = meets_sphere(&own, instance, sphere_at(&own, geometry, prim), below, above);
            continue;
        }
        const wide_corners_t given = load_wide_corners(&own, geometry, prim);
        const double3 corners[3] = {
            place_wide_point(&own, instance, given.a), place_wide_point(&own, instance, given.b),
            place_wide_point(&own, instance, given.c)};
        is_met[row] = meets_triangle(corners, own.world_scale[instance], below, above);
    }
}
