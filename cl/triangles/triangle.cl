// The watertight triangle test (Woop, Benthin and Wald, "Watertight ray/triangle intersection", 2013), with rays
// exactly through edges and vertices decided by simulation of simplicity.
//
// Shear: a permutation of the axes and a shear turn the ray into the z axis. They are the same for all vertices, so a
// vertex shared by two triangles stays shared.
//
// Edge functions: the sign of an edge function is always exact, so the two triangles at a shared edge never disagree on
// the side of the edge on which the ray passes.
//
// Perturbation: a ray exactly through an edge has an edge function of zero. The ray is perturbed symbolically by e *
// to_centre + (e^2, e^3), with to_centre towards the mesh's centre and an infinitely small e > 0 (Edelsbrunner and
// Muecke, "Simulation of simplicity", 1990). The perturbed ray meets no edge and no vertex, and passes both triangles
// at an edge on the same side of it, so a ray crosses a closed mesh exactly as often as it enters and leaves. Rays
// through the silhouette of a convex mesh are hits, because they are moved inwards.

#include "math/numeric.cl"
#include "hits/search.cl"
#include "exact/triangle.cl"

typedef struct {
    float3 a;
    float3 b;
    float3 c;
} corners_t;

// A vertex in the coordinates of the ray: x and y across the ray, z in units of t.
INLINED float3 shear_vertex(const float3 vertex, const ray_t *ray)
{
    const float3 permuted = permute_axes(vertex - ray->origin, ray->axis);
    return (float3)(
        permuted.x - ray->shear.x * permuted.z, permuted.y - ray->shear.y * permuted.z, ray->shear.z * permuted.z);
}

#if EXACT

// A vertex in the coordinates of the ray, with z as a length along the axis.
INLINED float3 shear_length(const float3 vertex, const ray_t *ray)
{
    const float3 permuted = permute_axes(vertex - ray->origin, ray->axis);
    return (float3)(permuted.x - ray->shear.x * permuted.z, permuted.y - ray->shear.y * permuted.z, permuted.z);
}

#endif

// a * b - c * d with an error below 1.5 units in the last place: the sign is exact, and the result is zero only where
// the difference is (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm for the accurate computation
// of 2x2 determinants", 2013). With a plain difference, which cancels, a ray beside a triangle seen edge-on would hit
// it.
INLINED float difference_of_products(const float a, const float b, const float c, const float d)
{
    const float rounded = c * d;
    return FUSED(a, b, -rounded) + FUSED(-c, d, rounded);
}

// Whether one of the three is negative and another one positive. NaN is neither.
INLINED bool have_opposite_signs(const float a, const float b, const float c)
{
    // No branches: which of the signs decides is not foreseen.
    return ((a < 0.0f) | (b < 0.0f) | (c < 0.0f)) & ((a > 0.0f) | (b > 0.0f) | (c > 0.0f));
}

// The edge function of the perturbed ray, of which only the sign is used: `edge` itself, or, where it is zero, the
// first of its derivatives along to_centre, x and y that is not zero. A vertex that the ray meets is at (0, 0), so the
// differences below are exact there; elsewhere it is enough that both triangles at the edge compute them with opposite
// signs.
INLINED float perturb_edge(const float edge, const float3 begin, const float3 end, const ray_t *ray)
{
    if (edge != 0.0f) {
        return edge;
    }
    // The mesh's centre, the origin of its coordinates, in those of the ray. Computed here because it is rarely needed.
    const float3 centre = permute_axes(-ray->origin, ray->axis);
    const float2 to_centre = centre.xy - ray->shear.xy * centre.z;
    const float2 along = end.xy - begin.xy;
    const float derivative = difference_of_products(to_centre.x, along.y, to_centre.y, along.x);
    return derivative != 0.0f ? derivative : along.y != 0.0f ? along.y : -along.x;
}

// Reports the crossing of the ray with the triangle of three sheared vertices, if there is one. NaN makes every
// comparison end in no crossing.
INLINED void intersect_sheared(
    const float3 a, const float3 b, const float3 c, const int prim_id, const int triangle_index, const ray_t *ray,
    search_t *search, const int query)
{
    // Edge functions: twice the signed areas that the ray spans with the edges opposite a, b and c.
    const float edge_a = difference_of_products(c.x, b.y, c.y, b.x);
    const float edge_b = difference_of_products(a.x, c.y, a.y, c.x);
    const float edge_c = difference_of_products(b.x, a.y, b.y, a.x);
    const float area = edge_a + edge_b + edge_c;
    const float sign_a = perturb_edge(edge_a, b, c, ray);
    const float sign_b = perturb_edge(edge_b, c, a, ray);
    const float sign_c = perturb_edge(edge_c, a, b, ray);
    if (have_opposite_signs(sign_a, sign_b, sign_c) || area == 0.0f) {
        return;
    }
    const float t = (edge_a * a.z + edge_b * b.z + edge_c * c.z) / area;
    if (t >= ray->t_min && t <= ray->t_max
        && !is_unseen(search, prim_id, (area > 0.0f) == (ray->shear.z > 0.0f))) {
        const crossing_t crossing = {t, edge_b / area, edge_c / area, prim_id, triangle_index};
        add_crossing(search, crossing, query);
    }
}

// Reports the crossing of the ray with a triangle in object space, if there is one.
INLINED void intersect_corners(
    const corners_t *corners, const int prim_id, const int triangle_index, const ray_t *ray, search_t *search,
    const int query)
{
#if EXACT
    decide_triangle(
        shear_length(corners->a, ray), shear_length(corners->b, ray), shear_length(corners->c, ray),
        reach_of(ray), prim_id, triangle_index, ray, search, query);
#else
    const float3 a = shear_vertex(corners->a, ray);
    const float3 b = shear_vertex(corners->b, ray);
    const float3 c = shear_vertex(corners->c, ray);
    // Plain differences may vanish but never have the wrong sign. They reject most triangles at little cost.
    if (!have_opposite_signs(c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x)) {
        intersect_sheared(a, b, c, prim_id, triangle_index, ray, search, query);
    }
#endif
}
