// The ray/sphere test. A sphere is crossed twice: where the ray enters (u is 0) and where it leaves (u is 1). A ray
// that starts inside only leaves. A ray that touches the sphere crosses it twice in one point, so the number of
// crossings along a whole line is always even.
//
// The textbook's discriminant cancels for small spheres far away, because it contains the square of the distance
// between the origin and the centre (Haines, Guenther and Akenine-Moeller, "Precision improvements for ray/sphere
// intersection", 2019). Here the ray is first moved to the plane through the centre at right angles to the direction's
// longest component, by the shear of the triangle test. From there on all lengths are relative to the radius:
//
//   at      the ray's point in that plane, as seen from the centre: (x, y, 0)
//   slope   the direction, with a longest component of 1: (sx, sy, 1)
//   |at + way * slope|^2 = radius^2, solved for the way, along the longest component
//
// The distance of the ray's line from the centre is |at x slope| / |slope|, a sum of squares: nothing cancels.
// docs/internals/padding.md bounds the error.

#include "exact/triangle.cl"
#include "hits/search.cl"

// A sphere in private memory.
typedef struct {
    float3 centre;
    float radius;
} ball_t;

// A sphere in the coordinates of the ray: the origin, moved along the ray's shear to the plane through the centre, as
// seen from there; and, as z, the origin's distance from that plane.
INLINED float3 shear_origin(const float3 centre, const ray_t *ray)
{
    const float3 permuted = permute_axes(ray->origin - centre, ray->axis);
    return (float3)(
        permuted.x - ray->shear.x * permuted.z, permuted.y - ray->shear.y * permuted.z, permuted.z);
}

// The square of the slope's length.
INLINED float slope_squared(const ray_t *ray)
{
    return 1.0f + ray->shear.x * ray->shear.x + ray->shear.y * ray->shear.y;
}

INLINED void add_sphere_crossing(
    const precise_t t, const bool is_leaving, const int prim_id, const int sphere_index, search_t *search,
    const int query)
{
#if EXACT
    crossing_t crossing = {0.0f, is_leaving ? 1.0f : 0.0f, 0.0f, prim_id, sphere_index};
    set_exact_t(&crossing, t);
#else
    const crossing_t crossing = {t, is_leaving ? 1.0f : 0.0f, 0.0f, prim_id, sphere_index};
#endif
    add_crossing(search, crossing, query);
}

// The part of a ray's line that is inside a sphere.
typedef struct {
    float unit;     // the radius but for a factor from 1 to 2: no square underflows, and a power of two rounds nothing
    float2 at;      // x and y of the ray's point in the plane through the centre, in units
    float way_in;   // where the line enters and leaves the sphere, along the longest component, in units
    float way_out;
} chord_t;

// Returns whether the line meets the sphere; of one that passes it, the chord is the nearest point. NaN makes the
// comparison end in no crossing.
INLINED bool find_chord(const float3 sheared, const float radius, const ray_t *ray, chord_t *chord)
{
    const int exponent = as_int(radius) & 0x7f800000;
    const float per_unit = as_float(0x7f000000 - exponent);
    const float r = radius * per_unit;
    const float2 at = sheared.xy * per_unit;

    const float square = slope_squared(ray);
    const float twist = at.x * ray->shear.y - at.y * ray->shear.x;
    const float discriminant = square * (r * r) - (at.x * at.x + at.y * at.y + twist * twist);
    const float root = sqrt(larger(discriminant, 0.0f));
    const float along = at.x * ray->shear.x + at.y * ray->shear.y;
    // Backwards along the longest component, the ray enters at the longer way.
    const float towards_entry = ray->shear.z < 0.0f ? root : -root;
    chord->unit = as_float(exponent);
    chord->at = at;
    chord->way_in = (towards_entry - along) / square;
    chord->way_out = (-towards_entry - along) / square;
    return discriminant >= 0.0f;
}

#if EXACT

// The test in doubles, on the sphere as it is in the file, in the local coordinates of its shape, where it is no
// ellipsoid: the textbook's, with the point of the ray that is nearest to the centre.
APART bool find_exact_chord(const ray_t *ray, const int prim_id, double *t_in, double *t_out)
{
    const global exact_instance_t *instance = ray->exact.instance;
    const global double *sphere = ray->exact.shapes.solids + instance->first_solid + 4 * (long)prim_id;
    const double3 start =
        transform_exactly(instance->to_object, ray->exact.origin - load_double3(instance->centre));
    const double3 direction = transform_exactly(instance->to_object, ray->exact.direction);
    const double3 to_centre = to_shape(instance, load_double3(sphere)) - start;
    const double radius = sphere[3] * instance->scale;
    const double square = dot3(direction, direction), middle = dot3(to_centre, direction) / square;
    const double3 away = to_centre - middle * direction;
    const double rest = radius * radius - dot3(away, away);
    if (!(rest >= 0.0)) {
        return false;
    }
    const double reach = sqrt(rest / square);
    *t_in = middle - reach - ray->exact.t_shift;
    *t_out = middle + reach - ray->exact.t_shift;
    return true;
}

// The sphere that float32 has to meet for the test in doubles: with the error of a corner, see exact/triangle.cl.
INLINED float grown_radius(const float3 sheared, const float radius, const ray_t *ray)
{
    const float wide = larger(absolute(sheared.x), absolute(sheared.y));
    return radius + 8.0f * CORNER_ERROR(reach_of(ray), absolute(sheared.z), wide + radius);
}

#endif

// Reports the crossings of the ray with a sphere, of which `sheared` is the sheared origin.
INLINED void intersect_sheared_origin(
    const float3 sheared, const float radius, const int prim_id, const int sphere_index, const ray_t *ray,
    search_t *search, const int query)
{
    chord_t chord;
#if EXACT
    double t_in, t_out;
    if (!find_chord(sheared, grown_radius(sheared, radius, ray), ray, &chord)
        || !find_exact_chord(ray, prim_id, &t_in, &t_out)) {
        return;
    }
#else
    if (!find_chord(sheared, radius, ray, &chord)) {
        return;
    }
    const float t_in = (chord.unit * chord.way_in - sheared.z) * ray->shear.z;
    const float t_out = (chord.unit * chord.way_out - sheared.z) * ray->shear.z;
#endif

    const bool enters = t_in >= ray->t_min && t_in <= ray->t_max && !is_unseen(search, prim_id, true);
    if (enters) {
        add_sphere_crossing(t_in, false, prim_id, sphere_index, search, query);
    }
    // Of the closest crossing, the first one decides.
    if (!(query == QUERY_CLOSEST && enters) && t_out >= ray->t_min && t_out <= ray->t_max
        && !is_unseen(search, prim_id, false)) {
        add_sphere_crossing(t_out, true, prim_id, sphere_index, search, query);
    }
}
