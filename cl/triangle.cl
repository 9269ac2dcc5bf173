// The watertight triangle test (Woop, Benthin and Wald, "Watertight ray/triangle intersection", 2013), with every edge
// on one side only.
//
// The ray becomes the z axis by a shear that is the same for every vertex, so the vertex that two triangles share
// stays shared. Edge functions never have the wrong sign, so a shared edge that one triangle has on its left has the
// other on its right. A ray exactly through an edge is taken for one that passes beside it (Edelsbrunner and Muecke,
// "Simulation of simplicity", 1990): the same side for both triangles, and no vertex or edge is left to be met. So a ray
// crosses a closed mesh exactly as often as it goes in and out. It leans towards the mesh's origin, its middle, so that
// the outline of a convex mesh belongs to it: by e * lean + (e * e, e * e * e) for an infinitely small e.

#include "numeric.cl"
#include "search.cl"

typedef struct {
    float3 a;
    float3 b;
    float3 c;
} corners_t;

// A vertex seen along the ray: x and y across it, z along it.
INLINED float3 shear_vertex(const float3 vertex, const path_t *path)
{
    const float3 turned = permute_axes(vertex - path->origin, path->axis);
    return (float3)(
        turned.x - path->shear.x * turned.z, turned.y - path->shear.y * turned.z, path->shear.z * turned.z);
}

// a * b - c * d to 1.5 units in the last place, so never with the wrong sign, and zero only where it is zero
// (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm for the accurate computation of 2x2
// determinants", 2013). A plain difference cancels: a triangle seen edge-on would be hit where the ray passes beside it.
INLINED float exact_difference(const float a, const float b, const float c, const float d)
{
    const float rounded = c * d;
    return FUSED(a, b, -rounded) + FUSED(-c, d, rounded);
}

// Whether two of the three are on opposite sides of zero. NaN is on neither.
INLINED bool disagree(const float a, const float b, const float c)
{
    return (a < 0.0f || b < 0.0f || c < 0.0f) && (a > 0.0f || b > 0.0f || c > 0.0f);
}

// An edge function, and what stands for it where it is zero: the first of its derivatives, along `lean`, x and y, that
// is not. Only the sign counts. Where a vertex is met it is at zero, so the differences are exact; elsewhere it is
// enough that the two triangles at the edge have them with opposite signs.
INLINED float side_of_edge(const float edge, const float3 begin, const float3 end, const path_t *path)
{
    if (edge != 0.0f) {
        return edge;
    }
    // To which side the ray leans: across it, towards the mesh's origin. Derived here, because it is hardly ever needed.
    const float3 back = permute_axes(-path->origin, path->axis);
    const float2 lean = back.xy - path->shear.xy * back.z;
    const float2 along = end.xy - begin.xy;
    const float leaning = exact_difference(lean.x, along.y, lean.y, along.x);
    return leaning != 0.0f ? leaning : along.y != 0.0f ? along.y : -along.x;
}

// Reports the crossing of the ray with the triangle of three sheared vertices, if there is one. Every comparison is
// written so that NaN means none.
INLINED void cross_sheared(
    const float3 a, const float3 b, const float3 c, const int prim_id, const int place, const path_t *path,
    search_t *search, const int query)
{
    // Twice the signed areas that the ray spans with the edges opposite a, b and c.
    const float edge_a = exact_difference(c.x, b.y, c.y, b.x);
    const float edge_b = exact_difference(a.x, c.y, a.y, c.x);
    const float edge_c = exact_difference(b.x, a.y, b.y, a.x);
    const float area = edge_a + edge_b + edge_c;
    const float side_a = side_of_edge(edge_a, b, c, path);
    const float side_b = side_of_edge(edge_b, c, a, path);
    const float side_c = side_of_edge(edge_c, a, b, path);
    if (disagree(side_a, side_b, side_c) || area == 0.0f) {
        return;
    }
    const float t = (edge_a * a.z + edge_b * b.z + edge_c * c.z) / area;
    if (t >= path->t_min && t <= path->t_max) {
        const crossing_t crossing = {t, edge_b / area, edge_c / area, prim_id, place};
        note_crossing(search, crossing, query);
    }
}

// The same for a triangle as it lies in space.
INLINED void intersect_corners(
    const corners_t *corners, const int prim_id, const int place, const path_t *path, search_t *search,
    const int query)
{
    const float3 a = shear_vertex(corners->a, path);
    const float3 b = shear_vertex(corners->b, path);
    const float3 c = shear_vertex(corners->c, path);
    // Plain differences may vanish but never have the wrong sign: they dismiss most triangles at once.
    if (!disagree(c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x)) {
        cross_sheared(a, b, c, prim_id, place, path, search, query);
    }
}
