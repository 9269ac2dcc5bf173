// Start points of rays that leave a surface, for clbvh/trace/hits/surface.py: so far above it that the tracer cannot
// meet it again.
//
// A point on a triangle, rounded to float in the tracer's local coordinates, may be on either side of the triangle that
// the tracer has in float, and the triangle test rounds as well. The distance is a bound on all these roundings, which
// docs/internals/offsets.md derives.
//
// The tracer takes a ray into an instance in float, so that map rounds as well: the bound is in the object's local
// coordinates. In a world with shapes that span scales, the same roundings are those of double, and relative to the
// primitive instead of the shape: `extent` is its size, or that of any shape, 1.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/locations.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "spheres/crossing.cl"

// Unit roundoffs of float and double.
#define FLOAT_ROUNDING 0x1p-24
#define DOUBLE_ROUNDING 0x1p-53

// Roundings of float between a point and the t of a triangle, by docs/internals/offsets.md.
#define ROUNDINGS 40

// Roundings of float on the way into an instance, and of double on the way to the world, by the same page.
#define ENTRY_ROUNDINGS 16
#define DOUBLE_ROUNDINGS 8

// Roundings of float relative to a sphere's radius, by the same page.
#define ROOT_ROUNDINGS 40

// Relative error of the difference of two positions that the device has as pairs of floats.
#define PAIR_ROUNDING 0x1p-45

// Float cannot tell the sides of an object whose start points would need more; no distance would do.
#define MOST_GROWTH 0.5

// A point of a primitive in its object's local coordinates, its normal, and the limits of the room above it.
typedef struct {
    // Above the surface: the unit normal on the side of the start point.
    double3 normal;
    double3 position;
    // How much higher than the point the tracer's primitive is.
    double highest;
    // The size that roundings are relative to, besides that of coordinates.
    double extent;
    // Beyond this height a start point would be on the other side of a sphere that it is in; else infinite.
    double most;
    // See `SurfaceArrays.margins`.
    double from_edge;
    double from_corner;
} footing_t;

static footing_t stand_on_triangle(
    const surfaces_t *surfaces, const int geometry, const int prim, const double u, const double v, const bool is_front)
{
    const wide_corners_t corners = load_wide_corners(surfaces, geometry, prim);
    const double scale = surfaces->scale[geometry];
    const double3 origin = load_wide_row(surfaces->origin, geometry);
    const float *margins = surfaces->margins + 4 * (surfaces->first_face[geometry] + prim) + (is_front ? 0 : 2);
    footing_t footing = {
        (is_front ? 1.0 : -1.0) * normal_of(&corners, scale), (point_on(&corners, u, v) - origin) * scale, 0.0, 1.0,
        INFINITY, margins[0], margins[1]};
    const double3 places[3] = {
        (corners.a - origin) * scale, (corners.b - origin) * scale, (corners.c - origin) * scale};
    if (surfaces->rounding < FLOAT_ROUNDING) {
        footing.extent = 0.0;
        for (int corner = 0; corner < 3; corner++) {
            footing.extent = max(footing.extent, largest_size(places[corner] - footing.position));
        }
    } else {
        for (int corner = 0; corner < 3; corner++) {
            const double3 on_device = convert_double3(convert_float3(places[corner]));
            footing.highest = max(footing.highest, dot3(on_device - footing.position, footing.normal));
        }
    }
    return footing;
}

// From inside, the sphere of float is as much higher as its surface lies within that of double.
static footing_t stand_on_sphere(
    const surfaces_t *surfaces, const int geometry, const int prim, const double u, const double v, const bool is_front)
{
    const double *sphere = sphere_at(surfaces, geometry, prim);
    const double scale = surfaces->scale[geometry], radius = sphere[3] * scale, side = is_front ? 1.0 : -1.0;
    const double3 normal = side * sphere_point(u, v);
    const double3 centre = (load_wide_row(sphere, 0) - load_wide_row(surfaces->origin, geometry)) * scale;
    const double3 position = centre + side * radius * normal;
    double highest;
    if (surfaces->rounding == FLOAT_ROUNDING) {
        highest = dot3(convert_double3(convert_float3(centre)) - position, normal);
        // No sphere has a smaller radius on the device.
        highest += side * max((double)(float)radius, (double)FLT_MIN);
    } else {
        highest = dot3(centre - position, normal) + side * radius;
    }
    const footing_t footing = {
        normal, position, max(highest, 0.0) + ROOT_ROUNDINGS * surfaces->rounding * radius,
        surfaces->rounding == FLOAT_ROUNDING ? 1.0 : 2.0 * radius, is_front ? INFINITY : radius, -INFINITY, -INFINITY};
    return footing;
}

// How far errors along the axes lead at most: in any direction, or in all of them inside of a sphere.
static double add_errors(const double3 errors, const bool is_inside_sphere)
{
    return is_inside_sphere ? errors.x + errors.y + errors.z : sqrt(dot3(errors, errors));
}

// How far rounding can move a point of a lone shape and its surface apart along each axis, in local units.
static double3 lone_roundings(const double rounding, const footing_t *footing, const double scale, const double3 point)
{
    const double error = ROUNDINGS * rounding * (largest_size(footing->position) + footing->extent);
    return error + 2 * DOUBLE_ROUNDING * fabs(point) * scale;
}

// The absolute values of which products with one of some matrices are the sums.
static double3 multiply_sizes(const double *matrices, const long index, const double3 sizes)
{
    const double *rows = matrices + 9 * index;
    return (double3)(
        fabs(rows[0]) * sizes.x + fabs(rows[1]) * sizes.y + fabs(rows[2]) * sizes.z,
        fabs(rows[3]) * sizes.x + fabs(rows[4]) * sizes.y + fabs(rows[5]) * sizes.z,
        fabs(rows[6]) * sizes.x + fabs(rows[7]) * sizes.y + fabs(rows[8]) * sizes.z);
}

// A column of one of some matrices, without signs.
static double3 column_sizes(const double *matrices, const long index, const int column)
{
    const double *from = matrices + 9 * index + column;
    return fabs((double3)(from[0], from[3], from[6]));
}

// How far float moves a ray and a primitive apart along each axis of an instance, and by how much more for a height of
// 1: in local units. `shares` is how far a start point is moved along each axis for a height of 1.
static void bound_roundings(
    const surfaces_t *surfaces, const int instance, const footing_t *footing, const double3 shares, double3 *errors,
    double3 *growths)
{
    double3 entry = (double3)(0.0), growth_of_entry = (double3)(0.0);
    for (int column = 0; column < 3; column++) {
        const double3 condition =
            multiply_sizes(surfaces->inverse, instance, column_sizes(surfaces->linear, instance, column));
        entry += condition * (footing->extent + fabs(footing->position[column]));
        growth_of_entry += condition * shares[column];
    }
    const double reach = footing->extent + largest_size(footing->position);
    *errors = surfaces->rounding * (ROUNDINGS * reach + ENTRY_ROUNDINGS * entry);
    *growths = surfaces->rounding * (ROUNDINGS * largest_size(shares) + ENTRY_ROUNDINGS * growth_of_entry);
}

// How far the roundings of world coordinates, in double and in pairs, move a point, added to `errors`: local units.
static double3 add_coarseness(
    const surfaces_t *surfaces, const int instance, const int geometry, const footing_t *footing, const double3 point,
    const double reach, double3 errors)
{
    const double scale = surfaces->scale[geometry];
    // The absolute values of which the point's world coordinates are the sums, and their own.
    double3 size = fabs(point) + fabs(load_wide_row(surfaces->offset, instance));
    const double3 place = fabs(footing->position) / scale + fabs(load_wide_row(surfaces->origin, geometry));
    for (int column = 0; column < 3; column++) {
        size += column_sizes(surfaces->linear, instance, column) * place[column];
    }
    const double3 moved = PAIR_ROUNDING * reach + DOUBLE_ROUNDINGS * DOUBLE_ROUNDING * size;
    for (int axis = 0; axis < 3; axis++) {
        errors += column_sizes(surfaces->inverse, instance, axis) * moved[axis] * scale;
    }
    return errors;
}

// The start point above a point in the world, and its height in local units.
static double3 rise_from(
    const surfaces_t *surfaces, const int instance, const footing_t *footing, const double3 point, const double reach,
    const bool is_upright, double *height)
{
    const int geometry = surfaces->geometry_id[instance];
    const double scale = surfaces->scale[geometry];
    const bool is_inside_sphere = isfinite(footing->most);
    if (surfaces->is_lone) {
        const double3 errors = lone_roundings(surfaces->rounding, footing, scale, point);
        *height = min(footing->highest + add_errors(errors, is_inside_sphere), footing->most);
        return point + *height * footing->normal / scale;
    }
    // The way in the world on which a height of 1 is gained in the object: along the world's normal, on which it is
    // shortest; inside of a sphere towards the centre, and no farther.
    double3 way = multiply(surfaces->linear, instance, footing->normal);
    if (!is_upright && !is_inside_sphere) {
        const direction_t turned = turn_normal(surfaces, instance, footing->normal);
        way = turned.unit / turned.length;
    }
    double3 errors, growths;
    bound_roundings(surfaces, instance, footing, fabs(multiply(surfaces->inverse, instance, way)), &errors, &growths);
    errors = add_coarseness(surfaces, instance, geometry, footing, point, reach, errors);
    const double growth = min(add_errors(growths, is_inside_sphere), MOST_GROWTH);
    *height = min((footing->highest + add_errors(errors, is_inside_sphere)) / (1.0 - growth), footing->most);
    return point + *height / scale * way;
}

// Points ahead whose triangles are fetched: their steps are too long for the processor to see the next points.
#define AHEAD 4

static void prefetch_prim(const surfaces_t *surfaces, const int instance, const int prim)
{
    const int geometry = surfaces->geometry_id[instance];
    if (surfaces->kind[geometry] == KIND_SPHERES) {
        return;
    }
    const int *face = face_at(surfaces, geometry, prim);
    __builtin_prefetch(surfaces->margins + 4 * (surfaces->first_face[geometry] + prim), 0, 3);
    for (int corner = 0; corner < 3; corner++) {
        __builtin_prefetch(vertex_at(surfaces, surfaces->first_vertex[geometry] + face[corner]), 0, 3);
    }
}

// Writes a point above each primitive, in world coordinates; NaN without one. Above is the outer side where `is_front`
// is true: along the world's normal, or along the object's if the point is to be upright there.
//
// arrays              `SurfaceArrays.addresses`
// reach               how far any coordinate of an instance can be from the middle of the world's box
// prim_ids[count], instance_ids[count], us[count], vs[count]    points on primitives; NO_PRIM for none
// heights[count]      written: those in the object's local units, of points that may be too close to another triangle,
//                     see host/hits/room.cl; 0 for all others
loop void offset_points(
    const ulong *arrays, const double reach, const bool is_upright, const long count, const int prim_ids[count],
    const int instance_ids[count], const double us[count], const double vs[count], const bool is_front[count],
    double points[count][3], double heights[count])
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    for (long hit = 0; hit < count; hit++) {
        const int prim = prim_ids[hit], instance = instance_ids[hit];
        heights[hit] = 0.0;
        if (hit + AHEAD < count && prim_ids[hit + AHEAD] != NO_PRIM) {
            prefetch_prim(&surfaces, instance_ids[hit + AHEAD], prim_ids[hit + AHEAD]);
        }
        if (prim == NO_PRIM) {
            vstore3((double3)(NAN), 0, points[hit]);
            continue;
        }
        const double u = us[hit], v = vs[hit], w = 1.0 - u - v;
        const int geometry = surfaces.geometry_id[instance];
        const footing_t footing = IS_SPHERES(surfaces.kind[geometry])
            ? stand_on_sphere(&surfaces, geometry, prim, u, v, is_front[hit])
            : stand_on_triangle(&surfaces, geometry, prim, u, v, is_front[hit]);
        const double3 point = locate_point(&surfaces, instance, prim, u, v);
        double height;
        vstore3(rise_from(&surfaces, instance, &footing, point, reach, is_upright, &height), 0, points[hit]);
        if (min(min(u, v), w) < footing.from_edge * height ||
            1.0 - max(max(u, v), w) < footing.from_corner * height) {
            heights[hit] = height;
        }
    }
}
