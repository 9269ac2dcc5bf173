// The triangle test in float64, on the file's own vertices: that of triangles/triangle.cl, and a bound on what float32
// rounds off that, so that all but a few triangles need no float64.
//
// Corners are placed in the world before they are sheared, so that a vertex has the same coordinates in all triangles,
// also of different sizes, and t is that of the world. Vertices and rays are rounded to the world's local coordinates
// by the same steps: a ray exactly through a vertex stays so.

#include "exact/ray.cl"
#include "hits/search.cl"
#include "math/numeric.cl"

#if EXACT

#if defined(__clang__) && defined(__FMA__) && !defined(PORTABLE)
#define FUSED_DOUBLE(a, b, c) __builtin_fma(a, b, c)
#else
#define FUSED_DOUBLE(a, b, c) fma(a, b, c)
#endif

// How far a sheared coordinate of a corner may be from that of the file's vertex and the user's ray, and how far an
// edge function of two such corners. `far` is the largest coordinate of the corners as seen from the origin, and `wide`
// the largest one across the ray; docs/internals/padding.md counts the roundings.
#define CORNER_ERROR(origin, far, wide) (ROUNDING * (8.0f * (origin) + 16.0f * (far) + 4.0f * (wide)))
#define EDGE_ERROR(corner_error, wide) (8.0f * (corner_error) * ((wide) + (corner_error)))

INLINED float largest_of(const float3 v)
{
    const float3 size = magnitude(v);
    return larger(size.x, larger(size.y, size.z));
}

// The largest coordinate of a ray's origin, for CORNER_ERROR; with room for the blur.
INLINED float reach_of(const ray_t *ray)
{
    return largest_of(ray->origin) + ray->exact.blur / (8.0f * ROUNDING);
}

// As difference_of_products.
INLINED double exact_difference(const double a, const double b, const double c, const double d)
{
    const double rounded = c * d;
    return FUSED_DOUBLE(a, b, -rounded) + FUSED_DOUBLE(-c, d, rounded);
}

INLINED double3 turn_axes(const double3 v, const int axis)
{
    return axis == 0 ? v.yzx : axis == 1 ? v.zxy : v;
}

// As shear_vertex; the direction is (x / z, y / z, 1 / z).
INLINED double3 shear_exactly(const double3 way, const double3 slopes, const int axis)
{
    const double3 turned = turn_axes(way, axis);
    return (double3)(turned.x - slopes.x * turned.z, turned.y - slopes.y * turned.z, slopes.z * turned.z);
}

// The way from the ray's origin to a corner of a triangle.
INLINED double3 way_to_corner(const exact_ray_t *ray, const global int *face, const int corner)
{
    const global exact_instance_t *instance = ray->instance;
    const global double *vertex = ray->shapes.vertices + 3 * (instance->first_vertex + face[corner]);
    const double3 own = to_shape(instance, load_double3(vertex));
#if LONE
    return own - ray->origin;
#else
    return transform_exactly(instance->to_world, own) + load_double3(instance->centre) - ray->origin;
#endif
}

// As perturb_edge.
INLINED double perturb_exactly(const double edge, const double3 begin, const double3 end, const double3 to_centre)
{
    if (edge != 0.0) {
        return edge;
    }
    const double x = end.x - begin.x, y = end.y - begin.y;
    const double derivative = exact_difference(to_centre.x, y, to_centre.y, x);
    return derivative != 0.0 ? derivative : y != 0.0 ? y : -x;
}

// As intersect_sheared.
APART bool cross_exactly(const ray_t *ray, const int prim_id, const int triangle_index, crossing_t *crossing)
{
    const exact_ray_t *own = &ray->exact;
    const double3 d = own->direction, size = fabs(d);
    const int axis = size.z >= size.x && size.z >= size.y ? 2 : size.y >= size.x ? 1 : 0;
    const double3 turned = turn_axes(d, axis);
    const double3 slopes = (double3)(turned.x / turned.z, turned.y / turned.z, 1.0 / turned.z);
    const global int *face = own->shapes.faces + 3 * (own->instance->first_face + prim_id);
    const double3 a = shear_exactly(way_to_corner(own, face, 0), slopes, axis);
    const double3 b = shear_exactly(way_to_corner(own, face, 1), slopes, axis);
    const double3 c = shear_exactly(way_to_corner(own, face, 2), slopes, axis);

    const double edge_a = exact_difference(c.x, b.y, c.y, b.x);
    const double edge_b = exact_difference(a.x, c.y, a.y, c.x);
    const double edge_c = exact_difference(b.x, a.y, b.y, a.x);
    const double area = edge_a + edge_b + edge_c;
    const double3 to_centre = shear_exactly(load_double3(own->instance->centre) - own->origin, slopes, axis);
    const double sign_a = perturb_exactly(edge_a, b, c, to_centre);
    const double sign_b = perturb_exactly(edge_b, c, a, to_centre);
    const double sign_c = perturb_exactly(edge_c, a, b, to_centre);
    const bool is_left = sign_a < 0.0 || sign_b < 0.0 || sign_c < 0.0;
    const bool is_right = sign_a > 0.0 || sign_b > 0.0 || sign_c > 0.0;
    if ((is_left && is_right) || area == 0.0) {
        return false;
    }
    const double t = (edge_a * a.z + edge_b * b.z + edge_c * c.z) / area - own->t_shift;
    if (!(t >= ray->t_min && t <= ray->t_max)) {
        return false;
    }
    crossing->u = (float)(edge_b / area);
    crossing->v = (float)(edge_c / area);
    crossing->prim_id = prim_id;
    crossing->triangle_index = triangle_index;
    crossing->is_front = (area > 0.0) == (slopes.z > 0.0);
#if !LONE
    // Seen in the world, a mirrored triangle is turned.
    const global double(*rows)[3] = own->instance->to_world;
    crossing->is_front ^= dot3(load_double3(rows[0]), cross3(load_double3(rows[1]), load_double3(rows[2]))) < 0.0;
#endif
    set_exact_t(crossing, t);
    return true;
}

// Lets float64 compute the t of a crossing.
INLINED void make_exact(const ray_t *ray, crossing_t *crossing)
{
    if (crossing->t_error > 0.0f) {
        cross_exactly(ray, crossing->prim_id, crossing->triangle_index, crossing);
    }
}

// Adds a crossing whose t float32 may have computed. Where that does not tell which of two is nearer, float64 does.
INLINED void add_sure_crossing(search_t *search, crossing_t crossing, const ray_t *ray, const int query)
{
    if (query == QUERY_CLOSEST) {
        crossing_t *nearest = &search->nearest;
        if (crossing.t - crossing.t_error > latest_t(nearest) * (1.0f + ERROR_BOUND(4))) {
            return;
        }
        if (latest_t(&crossing) * (1.0f + ERROR_BOUND(4)) >= nearest->t - nearest->t_error) {
            make_exact(ray, &crossing);
            make_exact(ray, nearest);
        } else {
            *nearest = crossing;
            return;
        }
    }
    add_crossing(search, crossing, query);
}

// Reports the crossing of the ray with the triangle of three sheared corners, if there is one: float32 tells where it
// is sure. Their z are lengths along the axis; `reach` is that of reach_of.
INLINED void decide_triangle(
    const float3 a, const float3 b, const float3 c, const float reach, const int prim_id, const int triangle_index,
    const ray_t *ray, search_t *search, const int query)
{
    const float wide = larger(
        larger(larger(absolute(a.x), absolute(a.y)), larger(absolute(b.x), absolute(b.y))),
        larger(absolute(c.x), absolute(c.y)));
    const float far = larger(larger(absolute(a.z), absolute(b.z)), absolute(c.z));
    const float corner_error = CORNER_ERROR(reach, far, wide);
    const float error = EDGE_ERROR(corner_error, wide);
    const float edge_a = c.x * b.y - c.y * b.x;
    const float edge_b = a.x * c.y - a.y * c.x;
    const float edge_c = b.x * a.y - b.y * a.x;
    const float least = smaller(smaller(edge_a, edge_b), edge_c);
    const float most = larger(larger(edge_a, edge_b), edge_c);
    // NaN fails all comparisons.
    if (!(least >= -error || most <= error)) {
        return;
    }
    crossing_t crossing;
    if ((least > error || most < -error) && query != QUERY_FIRST) {
        const float area = edge_a + edge_b + edge_c;
        const float spread = larger(larger(a.z, b.z), c.z) - smaller(smaller(a.z, b.z), c.z);
        const float way_error =
            16.0f * (error / absolute(area)) * spread + 2.0f * corner_error;
        crossing.t = (edge_a * a.z + edge_b * b.z + edge_c * c.z) / area * ray->shear.z;
        crossing.t_error = way_error * absolute(ray->shear.z);
        if (latest_t(&crossing) < ray->t_min || crossing.t - crossing.t_error > ray->t_max) {
            return;
        }
        if (crossing.t - crossing.t_error >= ray->t_min && latest_t(&crossing) <= ray->t_max) {
            crossing.u = edge_b / area;
            crossing.v = edge_c / area;
            crossing.t_low = 0.0f;
            crossing.prim_id = prim_id;
            crossing.triangle_index = triangle_index;
            if (!is_unseen(search, prim_id, (area > 0.0f) == (ray->shear.z > 0.0f))) {
                add_sure_crossing(search, crossing, ray, query);
            }
            return;
        }
    }
    if (cross_exactly(ray, prim_id, triangle_index, &crossing) && !is_unseen(search, prim_id, crossing.is_front)) {
        add_sure_crossing(search, crossing, ray, query);
    }
}

#endif
