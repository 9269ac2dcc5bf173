// The closest points of the primitives that a device found, in double, by clbvh/trace/points/refine.py.

#define IN_DOUBLES

#include "structs.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "nearest/ellipsoid.cl"
#include "triangles/closest.cl"

// A point farther from a lone mesh than `farthest` is moved to that distance, towards the centre: beyond it, doubles
// would round the differences to the corners more than the move changes. The same for an instance, in sizes of the
// primitive, and towards it: its closest point changes by a size over this number.
#define FAR_PRIM_SHARE 0x1p26

// A closest point in the world's coordinates, and its distance.
typedef struct {
    double3 point;
    double distance;
} found_t;

// The distance of points whose square may leave double, given about its size.
static double far_distance(const double3 point, const double3 closest, const double reach)
{
    const double3 away = (closest - point) / reach;
    return reach * sqrt(dot3(away, away));
}

static double3 place_point(const surfaces_t *surfaces, const int instance, const double3 point)
{
    return multiply(surfaces->linear, instance, point) + load_wide_row(surfaces->offset, instance);
}

static found_t close_to_triangle(
    const surfaces_t *surfaces, const double3 point, const int instance, const int prim, const double3 centre,
    const double farthest)
{
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
        reach = largest_size(point - centre);
        is_far = reach > farthest;
        const double3 own = is_far ? centre + (point - centre) * (farthest / reach) : point;
        a = (corners.a - own) * scale;
        b = (corners.b - own) * scale;
        c = (corners.c - own) * scale;
    } else {
        const double3 placed_ab = multiply(surfaces->linear, instance, ab);
        const double3 placed_ac = multiply(surfaces->linear, instance, ac);
        const double3 way = place_point(surfaces, instance, corners.a) - point;
        const double size = most_of(largest_size(placed_ab), largest_size(placed_ac));
        reach = largest_size(way);
        is_far = reach > FAR_PRIM_SHARE * size;
        const double share = is_far ? FAR_PRIM_SHARE * size / reach : 1.0;
        scale = power_of_two(-exponent_of(most_of(reach * share, size)));
        a = way * share * scale;
        b = a + placed_ab * scale;
        c = a + placed_ac * scale;
    }
    const triangle_point_t closest = closest_on_triangle(a, b, c);
    double3 on_triangle = corners.a + (closest.weights.y * ab + closest.weights.z * ac);
    if (!surfaces->is_lone) {
        on_triangle = place_point(surfaces, instance, on_triangle);
    }
    const found_t found = {
        on_triangle, is_far ? far_distance(point, on_triangle, reach) : sqrt(closest.squared) / scale};
    return found;
}

// The closest point of the ellipsoid that a placed sphere is.
//
// axes, half_lengths  of the ellipsoid that the instance makes of a sphere of radius 1
static found_t close_to_sphere(
    const surfaces_t *surfaces, const double3 point, const int instance, const int prim, const double *axes,
    const double *half_lengths)
{
    const double *sphere = sphere_at(surfaces, surfaces->geometry_id[instance], prim);
    const double3 centre = place_point(surfaces, instance, load_wide_row(sphere, 0));
    const double3 lengths = load_wide_row(half_lengths, instance) * sphere[3];
    const double3 way = point - centre;
    const double size = largest_size(lengths);
    const double reach = largest_size(way);
    const bool is_far = reach > FAR_PRIM_SHARE * size;
    const double share = is_far ? FAR_PRIM_SHARE * size / reach : 1.0;
    const int exponent = exponent_of(size);

    const double3 along = multiply(axes, instance, way);
    const double3 position = times_power_of_two3(fabs(along) * share, -exponent);
    const double3 scaled_lengths = times_power_of_two3(lengths, -exponent);
    const double3 shares = closest_shares(position, scaled_lengths);
    const double3 away = position - shares * scaled_lengths;

    found_t found = {centre, 0.0};
    for (int row = 0; row < 3; row++) {
        const double sign = along[row] < 0.0 ? -1.0 : 1.0;
        found.point += sign * shares[row] * lengths[row] * load_wide_row(axes, 3 * instance + row);
    }
    found.distance = is_far
        ? far_distance(point, found.point, reach)
        : times_power_of_two(sqrt(dot3(away, away)), exponent);
    return found;
}

// Writes the closest point of each primitive, to slots. Without a primitive the distance is infinite, the point NaN,
// and the ids NO_PRIM.
//
// points[][3]         floats or doubles, by is_double
// order[row_count]    the point of each primitive, by its number
// arrays              `SurfaceArrays.addresses`
// axes, half_lengths  see `Metrics`
// centre, farthest    of the box of a lone shape, and how far from it points are moved to
// prims, instances    the primitives
loop void refine_points(
    const void *points, const bool is_double, const long row_count, const int order[row_count], const ulong *arrays,
    const double *axes, const double *half_lengths, const double centre[3], const double farthest,
    const int prims[row_count], const int instances[row_count], const int slots[row_count], double *distances,
    double *closest, int *prim_ids, int *instance_ids)
{
    surfaces_t surfaces = *(const surfaces_t *)arrays;
    surfaces.has_doubles = 1;
    const long step = is_double ? sizeof(double) : sizeof(float);
    for (long row = 0; row < row_count; row++) {
        const int slot = slots[row];
        const int prim = prims[row];
        const int instance = instances[row];
        prim_ids[slot] = prim;
        instance_ids[slot] = instance;
        found_t nearest = {(double3)(NAN), INFINITY};
        if (prim != NO_PRIM) {
            const double3 point = load_vector((const char *)points + 3L * order[row] * step, step, is_double);
            nearest = surfaces.kind[surfaces.geometry_id[instance]] == KIND_SPHERES
                ? close_to_sphere(&surfaces, point, instance, prim, axes, half_lengths)
                : close_to_triangle(
                    &surfaces, point, instance, prim, vload3(0, centre), farthest);
        }
        distances[slot] = nearest.distance;
        vstore3(nearest.point, slot, closest);
    }
}
