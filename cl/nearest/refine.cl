// The points of near primitives, computed again in double from the numbers of the file.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "rays/pack.cl"
#include "spheres/crossing.cl"
#include "triangles/closest.cl"
#define IN_DOUBLES
#include "nearest/ellipsoid.cl" // again, in doubles
#undef IN_DOUBLES

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A point farther from a lone mesh than this many times half the box's size is moved to that distance, towards the
// centre: beyond it, doubles would round the differences to the corners more than the move changes. The same for an
// instance, in sizes of the primitive, and towards it: its closest point changes by a size over this number.
#define FAR_SHARE 0x1p20
#define FAR_PRIM_SHARE 0x1p26

// Arguments that kernels and loops share:
//
// surfaces                    `SurfaceArrays.addresses`
// ellipsoid_axes[][9], half_lengths[][3]    of the ellipsoids that instances make of a sphere, see `Metrics`
// distances[], closest[][3], us[], vs[], prim_ids[], instance_ids[]    written: `FoundPoints`
#define REFINED_ARGUMENTS \
    const global ulong *restrict surfaces, const global double *restrict ellipsoid_axes, \
    const global double *restrict half_lengths, global double *restrict distances, global double *restrict closest, \
    global double *restrict us, global double *restrict vs, global int *restrict prim_ids, \
    global int *restrict instance_ids

// From these arguments, and box[7] of the world.
#define WIDE_WORLD {surfaces_on_host(surfaces), ellipsoid_axes, half_lengths, load_tree_box(box)}
#define FOUND_POINTS {distances, closest, us, vs, prim_ids, instance_ids}

// A world in double, as points see it.
typedef struct {
    surfaces_t surfaces;
    const double *ellipsoid_axes;
    const double *half_lengths;
    tree_box_t box;
} wide_world_t;

// The closest point of a primitive in the world's coordinates, and its distance; and of a triangle the weights of its
// corners, of a sphere the way from its centre.
typedef struct {
    double3 point;
    double distance;
    double3 place;
} closest_t;

typedef struct {
    double *distances;
    double *closest;
    double *us;
    double *vs;
    int *prim_ids;
    int *instance_ids;
} found_points_t;

// The distance of points whose square may leave double, given about its size.
INLINED double far_distance(const double3 point, const double3 closest, const double reach)
{
    const double3 away = (closest - point) / reach;
    return reach * sqrt(dot3(away, away));
}

INLINED double3 place_wide_point(const surfaces_t *surfaces, const int instance, const double3 point)
{
    return multiply(surfaces->linear, instance, point) + load_wide_row(surfaces->offset, instance);
}

INLINED closest_t
close_to_triangle(const wide_world_t *world, const double3 point, const int instance, const int prim)
{
    const surfaces_t *surfaces = &world->surfaces;
    const wide_corners_t corners = load_wide_corners(surfaces, surfaces->geometry_id[instance], prim);
    // The first corner and the edges from there, which are placed by themselves: far from zero they keep digits that
    // differences of placed corners would lose.
    const double3 ab = corners.b - corners.a;
    const double3 ac = corners.c - corners.a;
    // The corners as seen from the point, times a power of two.
    double3 a, b, c;
    double scale, reach;
    bool is_far;
    if (surfaces->is_lone) {
        scale = surfaces->scale[0];
        const double farthest = FAR_SHARE * largest_size(world->box.half_size) / world->box.scale;
        reach = largest_size(point - world->box.centre);
        is_far = reach > farthest;
        const double3 own =
            is_far ? world->box.centre + (point - world->box.centre) * (farthest / reach) : point;
        a = (corners.a - own) * scale;
        b = (corners.b - own) * scale;
        c = (corners.c - own) * scale;
    } else {
        const double3 placed_ab = multiply(surfaces->linear, instance, ab);
        const double3 placed_ac = multiply(surfaces->linear, instance, ac);
        const double3 way = place_wide_point(surfaces, instance, corners.a) - point;
        const double size = most_of(largest_size(placed_ab), largest_size(placed_ac));
        reach = largest_size(way);
        is_far = reach > FAR_PRIM_SHARE * size;
        const double share = is_far ? FAR_PRIM_SHARE * size / reach : 1.0;
        scale = power_of_two(-exponent_of(most_of(reach * share, size)));
        a = way * share * scale;
        b = a + placed_ab * scale;
        c = a + placed_ac * scale;
    }
    const triangle_point_t on_corners = closest_on_triangle(a, b, c);
    double3 on_triangle = corners.a + (on_corners.weights.y * ab + on_corners.weights.z * ac);
    if (!surfaces->is_lone) {
        on_triangle = place_wide_point(surfaces, instance, on_triangle);
    }
    const closest_t closest = {
        on_triangle, is_far ? far_distance(point, on_triangle, reach) : sqrt(on_corners.squared) / scale,
        on_corners.weights};
    return closest;
}

// The closest point of the ellipsoid that a placed sphere is.
INLINED closest_t
close_to_sphere(const wide_world_t *world, const double3 point, const int instance, const int prim)
{
    const surfaces_t *surfaces = &world->surfaces;
    const double *sphere = sphere_at(surfaces, surfaces->geometry_id[instance], prim);
    const double3 centre = place_wide_point(surfaces, instance, load_wide_row(sphere, 0));
    const double3 lengths = load_wide_row(world->half_lengths, instance) * sphere[3];
    const double3 way = point - centre;
    const double size = largest_size(lengths);
    const double reach = largest_size(way);
    const bool is_far = reach > FAR_PRIM_SHARE * size;
    const double share = is_far ? FAR_PRIM_SHARE * size / reach : 1.0;
    const int exponent = exponent_of(size);

    const double3 along = multiply(world->ellipsoid_axes, instance, way);
    const double3 position = times_power_of_two3(fabs(along) * share, -exponent);
    const double3 scaled_lengths = times_power_of_two3(lengths, -exponent);
    const double3 shares = closest_shares(position, scaled_lengths);
    const double3 away = position - shares * scaled_lengths;

    closest_t closest = {centre, 0.0, (double3)(0.0)};
    for (int row = 0; row < 3; row++) {
        const double sign = along[row] < 0.0 ? -1.0 : 1.0;
        closest.place += sign * shares[row] * lengths[row] * load_wide_row(world->ellipsoid_axes, 3 * instance + row);
    }
    closest.point += closest.place;
    closest.distance = is_far
        ? far_distance(point, closest.point, reach)
        : times_power_of_two(sqrt(dot3(away, away)), exponent);
    return closest;
}

// The closest point of a primitive, or of none.
INLINED closest_t
find_closest(const wide_world_t *world, const double3 point, const int instance, const int prim)
{
    if (prim == NO_PRIM) {
        const closest_t none = {(double3)(NAN), INFINITY, (double3)(0.0)};
        return none;
    }
    if (IS_SPHERES(world->surfaces.kind[world->surfaces.geometry_id[instance]])) {
        return close_to_sphere(world, point, instance, prim);
    }
    return close_to_triangle(world, point, instance, prim);
}

// The coordinates u and v of a closest point, see `Hits`; 0 of none.
INLINED double2 find_uv(const wide_world_t *world, const closest_t *closest, const int instance, const int prim)
{
    if (prim == NO_PRIM || IS_TRIANGLES(world->surfaces.kind[world->surfaces.geometry_id[instance]])) {
        return closest->place.yz;
    }
    return sphere_uv(unit_of_any(multiply(world->surfaces.inverse, instance, closest->place)));
}

// Asks for the places of a closest point before it is looked for.
INLINED void will_write_closest(const found_points_t *found, const long slot)
{
    WILL_WRITE(found->distances + slot);
    WILL_WRITE(found->closest + 3 * slot);
    WILL_WRITE(found->closest + 3 * slot + 2);
    WILL_WRITE(found->us + slot);
    WILL_WRITE(found->vs + slot);
    WILL_WRITE(found->prim_ids + slot);
    WILL_WRITE(found->instance_ids + slot);
}

// Writes the closest point of a primitive to a slot. Without one the distance is infinite, the point NaN, and the ids
// NO_PRIM.
INLINED void write_closest(
    const wide_world_t *world, const double3 point, const int instance, const int prim, const found_points_t *found,
    const long slot)
{
    const closest_t closest = find_closest(world, point, instance, prim);
    const double2 uv = find_uv(world, &closest, instance, prim);
    found->distances[slot] = closest.distance;
    vstore3(closest.point, slot, found->closest);
    found->us[slot] = uv.x;
    found->vs[slot] = uv.y;
    found->prim_ids[slot] = prim;
    found->instance_ids[slot] = instance;
}
