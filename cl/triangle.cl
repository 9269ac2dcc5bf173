// The watertight triangle test (Woop, Benthin and Wald, "Watertight ray/triangle intersection", 2013).
//
// The ray becomes the z axis by a shear that is the same for every vertex, so the vertex that two triangles share
// stays shared. Edge functions never have the wrong sign, so a shared edge that one triangle has on its left has the
// other on its right; zero counts as inside. So a ray that crosses a closed mesh crosses one of its triangles at least.

#include "crossing.cl"
#include "ray.cl"

// A vertex seen along the ray: x and y across it, z along it.
float3 shear_vertex(const float3 vertex, const path_t *path)
{
    const float3 turned = permute_axes(vertex - path->origin, path->axis);
    return (float3)(
        turned.x - path->shear.x * turned.z, turned.y - path->shear.y * turned.z, path->shear.z * turned.z);
}

// a * b - c * d to 1.5 units in the last place, so never with the wrong sign, and zero only where it is zero
// (Jeannerod, Louvet and Muller, "Further analysis of Kahan's algorithm for the accurate computation of 2x2
// determinants", 2013). A plain difference cancels: a triangle seen edge-on would be hit where the ray passes beside it.
float exact_difference(const float a, const float b, const float c, const float d)
{
    const float rounded = c * d;
    return fma(a, b, -rounded) + fma(-c, d, rounded);
}

// Whether two of the three are on opposite sides of zero. NaN is on neither.
bool disagree(const float a, const float b, const float c)
{
    return (a < 0.0f || b < 0.0f || c < 0.0f) && (a > 0.0f || b > 0.0f || c > 0.0f);
}

// Replaces *nearest when the ray meets the triangle nearer, or just as near with a smaller number: ties are broken the
// same way whatever the order of the tests. Every comparison is written so that NaN means no hit.
void intersect_triangle(
    const global triangle_t *triangles, const int place, const path_t *path, crossing_t *nearest)
{
    const global triangle_t *triangle = triangles + place;
    const float3 a = shear_vertex(vload3(0, triangle->a), path);
    const float3 b = shear_vertex(vload3(0, triangle->b), path);
    const float3 c = shear_vertex(vload3(0, triangle->c), path);

    // Twice the signed areas that the ray spans with the edges opposite a, b and c. Plain differences may vanish but
    // never have the wrong sign: they dismiss most triangles at once.
    if (disagree(c.x * b.y - c.y * b.x, a.x * c.y - a.y * c.x, b.x * a.y - b.y * a.x)) {
        return;
    }
    const float edge_a = exact_difference(c.x, b.y, c.y, b.x);
    const float edge_b = exact_difference(a.x, c.y, a.y, c.x);
    const float edge_c = exact_difference(b.x, a.y, b.y, a.x);
    const float area = edge_a + edge_b + edge_c;
    if (disagree(edge_a, edge_b, edge_c) || area == 0.0f) {
        return;
    }

    const float t = (edge_a * a.z + edge_b * b.z + edge_c * c.z) / area;
    const bool nearer = t < nearest->t || (t == nearest->t && triangle->prim_id < nearest->prim_id);
    if (t >= path->t_min && t <= path->t_max && nearer) {
        nearest->t = t;
        nearest->u = edge_b / area;
        nearest->v = edge_c / area;
        nearest->prim_id = triangle->prim_id;
        nearest->place = place;
    }
}
