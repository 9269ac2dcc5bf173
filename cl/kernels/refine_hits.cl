// Computes hits on triangles again in double, on the file's own vertices, to the bits of clbvh/trace/hits/refine.py,
// which tells why.
//
// Shared arguments, of which ray_count hits are refined: see cl/rays/arrays.cl.
// found[ray_count]             with a lone shape
// found_in_world[ray_count]    the same buffer, with any other world
// vertices[], faces[]          of all meshes, packed, see `SurfaceArrays`
// has_doubles                  whether vertices are doubles; else floats
// first_rows[geometries][2]    where the vertices and the faces of a geometry begin
// geometry_ids[instances]
// instances[][14]              the linear part by rows, the translation, the scale, and 1 if it is a mirror
// is_lone                      whether instance 0 is all there is, and its vertices are where the file says
// t[], u[], v[], is_front[], prim_id[], instance_id[], geometry_id[]    written, from the first ray on, axes[0]
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "structs.cl"
#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// The share of clbvh/trace/hits/refine.py below which a triangle is seen edge-on.
#define EDGE_ON 0x1p-36
#define INSTANCE_NUMBERS 14

// A ray's direction, and a triangle as seen from its origin: the corner a, and the edges to b and c.
typedef struct {
    double3 direction;
    double3 corner;
    double3 ab;
    double3 ac;
} meeting_t;

INLINED double3 load_vertex(const global char *vertices, const long vertex, const int is_double)
{
    const int size = is_double ? sizeof(double) : sizeof(float);
    return load_vector(vertices + 3 * size * vertex, size, is_double);
}

INLINED double3 place_vector(const global double *rows, const double3 v)
{
    return (double3)(
        rows[0] * v.x + rows[1] * v.y + rows[2] * v.z, rows[3] * v.x + rows[4] * v.y + rows[5] * v.z,
        rows[6] * v.x + rows[7] * v.y + rows[8] * v.z);
}

INLINED bool is_inside(const double u, const double v)
{
    return u >= 0.0 && v >= 0.0 && u + v <= 1.0;
}

// The sums of the sizes of the products of which a cross product is the difference.
INLINED double3 cross_sizes(const double3 a, const double3 b)
{
    return fabs(a.yzx * b.zxy) + fabs(a.zxy * b.yzx);
}

// (t, u, v) of the point of the triangle's edges that is nearest to the ray's line; `tuv` are those in its plane.
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

// (t, u, v) in the plane of the triangle, or on its edge, and the volume whose sign is the ray's side.
INLINED double3 meet_triangle(const meeting_t *meeting, double *volume)
{
    const double3 d = meeting->direction, ab = meeting->ab, ac = meeting->ac;
    const double3 p = cross3(d, ac), q = cross3(meeting->corner, ab);
    *volume = dot3(ab, p);
    double3 tuv = (double3)(-dot3(ac, q) / *volume, -dot3(meeting->corner, p) / *volume, -dot3(d, q) / *volume);
    const double sides = (fabs(ab.x) + fabs(ab.y) + fabs(ab.z)) * (fabs(ac.x) + fabs(ac.y) + fabs(ac.z));
    if (fabs(*volume) <= EDGE_ON * sides * (fabs(d.x) + fabs(d.y) + fabs(d.z))) {
        tuv.y = NAN;
    }
    return is_inside(tuv.y, tuv.z) && isfinite(tuv.x) ? tuv : move_onto_edge(meeting, tuv);
}

kernel void refine_hits(
    ARRAY_ARGUMENTS, const global hit_t *restrict found, const global world_hit_t *restrict found_in_world,
    const global char *restrict vertices, const int has_doubles, const global int *restrict faces,
    const global long *restrict first_rows, const global int *restrict geometry_ids,
    const global double *restrict instances, const int is_lone,
    global double *restrict t, global double *restrict u, global double *restrict v, global char *restrict is_front,
    global int *restrict prim_id, global int *restrict instance_id, global int *restrict geometry_id)
{
    const int index = get_global_id(0);
    if (index >= ray_count) {
        return;
    }
    const long target = axes[0] + index;
    const int prim = is_lone ? found[index].prim_id : found_in_world[index].prim_id;
    prim_id[target] = prim;
    if (prim == NO_PRIM) {
        t[target] = INFINITY;
        u[target] = v[target] = 0.0;
        is_front[target] = 0;
        instance_id[target] = geometry_id[target] = NO_PRIM;
        return;
    }
    const int instance = is_lone ? 0 : found_in_world[index].instance_id;
    const int geometry = geometry_ids[instance];
    const global double *numbers = instances + INSTANCE_NUMBERS * (long)instance;
    const double scale = numbers[12];
    const wide_ray_t ray = load_wide_ray(
        origins, directions, doubles, axes, axis_count, t_mins, t_maxs, each_limit, index);

    const long first = first_rows[2 * geometry];
    const global int *face = faces + 3 * (first_rows[2 * geometry + 1] + prim);
    double3 a = load_vertex(vertices, first + face[0], has_doubles);
    double3 ab = load_vertex(vertices, first + face[1], has_doubles) - a;
    double3 ac = load_vertex(vertices, first + face[2], has_doubles) - a;
    if (!is_lone) {
        a = place_vector(numbers, a) + (double3)(numbers[9], numbers[10], numbers[11]);
        ab = place_vector(numbers, ab);
        ac = place_vector(numbers, ac);
    }
    const int exponent = exponent_of(largest_size(ray.direction));
    const meeting_t meeting = {
        times_power_of_two3(ray.direction, -exponent), (a - ray.origin) * scale, ab * scale, ac * scale};
    double volume;
    const double3 tuv = meet_triangle(&meeting, &volume);
    const double own_t = times_power_of_two(tuv.x, -(exponent + exponent_of(scale)));
    // Infinity is the t of a miss.
    t[target] = least_of(least_of(most_of(own_t, ray.t_min), ray.t_max), 0x1.fffffffffffffp1023);
    u[target] = tuv.y;
    v[target] = tuv.z;
    is_front[target] = (!is_lone && numbers[13] != 0.0 ? -volume : volume) > 0.0;
    instance_id[target] = instance;
    geometry_id[target] = geometry;
}
