// Hits from the device are computed again in double, on the file's own vertices.
//
// Of what a traversal found only the primitive counts. So t, u and v depend on nothing but the ray and the primitive,
// and not on the layout, the device, or its compiler.
//
// Triangles of instances are placed first and intersected then, so that their hits are as exact far from the world's
// zero as they are in a mesh that lies there. A placed sphere is an ellipsoid, so there the ray goes into the
// geometry's coordinates.

#include "structs.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "rays/arrays.cl"
#include "spheres/crossing.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A triangle is seen edge-on where the volume that its edges span with the ray is below this share of the products of
// which it is the sum. Double then knows t to 1e-5 of the triangle's size at best.
#define EDGE_ON 0x1p-36

// The t of a hit beyond double: infinity is the t of a miss.
#define MOST_T 0x1.fffffffffffffp1023

// A hit in lengths of the ray's direction. With t within the ray's limits; `side` is above 0 if the ray meets the
// front.
typedef struct {
    double t;
    double u;
    double v;
    double side;
} refined_hit_t;

// A ray's direction, whose longest component is from 1 to 2, and a triangle as seen from its origin: the corner a, and
// the edges to b and c, in units of `world_scale`.
typedef struct {
    double3 direction;
    double3 corner;
    double3 ab;
    double3 ac;
} meeting_t;

INLINED bool is_inside(const double u, const double v)
{
    return u >= 0.0 && v >= 0.0 && u + v <= 1.0;
}

// The sums of the sizes of the products of which a cross product is the difference.
INLINED double3 cross_sizes(const double3 a, const double3 b)
{
    return fabs(a.yzx * b.zxy) + fabs(a.zxy * b.yzx);
}

// (t, u, v) of the point of the triangle's edges that is nearest to the ray's line; `tuv` are those in its plane. Of a
// triangle seen edge-on, to the part of the line that the ray is: the line crosses two edges. A ray that may be in the
// triangle's plane, where u is NaN, stays inside the triangle if its crossing is known.
//
// The device sees a rounded ray and a rounded triangle, which can meet where the exact ones pass each other.
INLINED double3 move_onto_edge(const meeting_t *meeting, double3 tuv)
{
    const double3 direction = meeting->direction, corner = meeting->corner;
    bool is_edge_on = false;
    if (isnan(tuv.y)) {
        const double3 normal_way = cross3(direction, meeting->ac);
        const double volume = dot3(meeting->ab, normal_way);
        is_edge_on = !(fabs(volume) > EDGE_ON * dot3(fabs(meeting->ab), cross_sizes(direction, meeting->ac)));
        const double u = -dot3(corner, normal_way) / volume;
        if (!is_edge_on && is_inside(u, tuv.z)) {
            tuv.y = u;
            return tuv;
        }
    }
    const double square = dot3(direction, direction);
    double least = INFINITY;
    // The edge from b to c, from c to a, from a to b: its begin and its way, less their shares along the ray.
    for (int edge = 0; edge < 3; edge++) {
        const double3 to_begin = edge == 0 ? meeting->ab : edge == 1 ? meeting->ac : (double3)(0.0);
        const double3 to_end = edge == 0 ? meeting->ac : edge == 1 ? (double3)(0.0) : meeting->ab;
        const double3 begin = corner + to_begin, way = to_end - to_begin;
        const double3 beside = begin + -dot3(begin, direction) / square * direction;
        const double3 across = way + -dot3(way, direction) / square * direction;
        // An edge along the ray has no nearest point: 0 / 0, and the comparison makes it the begin.
        double share = -dot3(beside, across) / dot3(across, across);
        share = share > 0.0 ? least_of(share, 1.0) : 0.0;
        double t = dot3(begin + share * way, direction) / square;
        if (is_edge_on && t < 0.0) {
            // Along the edge to where the ray begins, if it reaches so far.
            share = least_of(most_of(-dot3(begin, direction) / dot3(way, direction), 0.0), 1.0);
            t = 0.0 < share && share < 1.0 ? 0.0 : dot3(begin + share * way, direction) / square;
        }
        const double3 offset = beside + share * across;
        double distance = dot3(offset, offset);
        if (is_edge_on && t < 0.0) {
            distance += t * t * square;
        }
        if (distance < least) {
            least = distance;
            const double rest = 1.0 - share;
            tuv = (double3)(t, edge == 0 ? rest : edge == 1 ? 0.0 : share, edge == 0 ? share : edge == 1 ? rest : 0.0);
        }
    }
    return tuv;
}

// (t, u, v) in the plane of the triangle, or on its edge, and the volume of the parallelepiped of its edges and the
// direction, whose sign is the ray's side.
//
// Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
INLINED double3 meet_triangle(const meeting_t *meeting, double *volume)
{
    const double3 d = meeting->direction, ab = meeting->ab, ac = meeting->ac;
    const double3 p = cross3(d, ac), q = cross3(meeting->corner, ab);
    *volume = dot3(ab, p);
    double3 tuv = (double3)(-dot3(ac, q) / *volume, -dot3(meeting->corner, p) / *volume, -dot3(d, q) / *volume);
    // Of a ray in the triangle's plane, but for rounding, this leaves noise: with NaN, `move_onto_edge` looks closer.
    // Here the volume is compared with that of a box with these sides, which is cheaper, and too strict for slivers.
    const double sides = (fabs(ab.x) + fabs(ab.y) + fabs(ab.z)) * (fabs(ac.x) + fabs(ac.y) + fabs(ac.z));
    if (fabs(*volume) <= EDGE_ON * sides * (fabs(d.x) + fabs(d.y) + fabs(d.z))) {
        tuv.y = NAN;
    }
    return is_inside(tuv.y, tuv.z) && isfinite(tuv.x) ? tuv : move_onto_edge(meeting, tuv);
}

INLINED refined_hit_t refine_on_triangle(
    const surfaces_t *surfaces, const wide_ray_t *ray, const int instance, const int geometry, const int prim)
{
    const wide_corners_t corners = load_wide_corners(surfaces, geometry, prim);
    double3 a = corners.a, ab = corners.b - a, ac = corners.c - a;
    if (!surfaces->is_lone) {
        a = multiply(surfaces->linear, instance, a) + load_wide_row(surfaces->offset, instance);
        ab = multiply(surfaces->linear, instance, ab);
        ac = multiply(surfaces->linear, instance, ac);
    }
    const double scale = surfaces->world_scale[instance];
    const int exponent = exponent_of(largest_size(ray->direction));
    const meeting_t meeting = {
        times_power_of_two3(ray->direction, -exponent), (a - ray->origin) * scale, ab * scale, ac * scale};
    double volume;
    const double3 tuv = meet_triangle(&meeting, &volume);
    const double t = times_power_of_two(tuv.x, -(exponent + exponent_of(scale)));
    const bool is_turned = !surfaces->is_lone && surfaces->is_mirrored[instance];
    const refined_hit_t hit = {t, tuv.y, tuv.z, is_turned ? -volume : volume};
    return hit;
}

INLINED refined_hit_t refine_on_sphere(
    const surfaces_t *surfaces, const wide_ray_t *ray, const int instance, const int geometry, const int prim,
    const bool is_leaving)
{
    const global double *sphere = sphere_at(surfaces, geometry, prim);
    double3 normal;
    const double t = sphere_crossing(
        multiply(surfaces->inverse, instance, ray->origin - load_wide_row(surfaces->offset, instance)),
        multiply(surfaces->inverse, instance, ray->direction), load_wide_row(sphere, 0), sphere[3], is_leaving,
        &normal);
    const double2 uv = sphere_uv(normal);
    const refined_hit_t hit = {t, uv.x, uv.y, is_leaving ? -1.0 : 1.0};
    return hit;
}

// The hit of a ray on a primitive that a traversal found. Where double sees the ray pass beside the primitive, by less
// than float resolves, t, u and v are those of the primitive's point that is nearest to the ray.
//
// ray                 as the user gave it
// instance, prim      0 is the instance of a lone shape
// is_leaving          of a sphere, which of the two crossings
INLINED refined_hit_t refine_hit(
    const surfaces_t *surfaces, const wide_ray_t *ray, const int instance, const int prim, const bool is_leaving)
{
    const int geometry = surfaces->geometry_id[instance];
    refined_hit_t hit = IS_SPHERES(surfaces->kind[geometry])
        ? refine_on_sphere(surfaces, ray, instance, geometry, prim, is_leaving)
        : refine_on_triangle(surfaces, ray, instance, geometry, prim);
    hit.t = least_of(least_of(most_of(hit.t, ray->t_min), ray->t_max), MOST_T);
    return hit;
}
