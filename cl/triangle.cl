// The watertight triangle test (Woop, Benthin and Wald, "Watertight ray/triangle intersection", 2013).
//
// The ray becomes the z axis by a shear that is the same for every vertex, so the vertex that two triangles share
// stays shared. The edge functions of a shared edge are exact negatives of each other, and rounding never turns their
// sign: at worst it makes both zero, and zero counts as inside. So a ray that crosses a closed mesh crosses one of
// its triangles at least.

#include "crossing.cl"
#include "ray.cl"

// A vertex seen along the ray: x and y across it, z along it.
float3 shear_vertex(const float3 vertex, const path_t *path)
{
    const float3 turned = permute_axes(vertex - path->origin, path->axis);
    return (float3)(
        turned.x - path->shear.x * turned.z, turned.y - path->shear.y * turned.z, path->shear.z * turned.z);
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

    // Twice the signed areas that the ray spans with the edges opposite a, b and c.
    const float edge_a = c.x * b.y - c.y * b.x;
    const float edge_b = a.x * c.y - a.y * c.x;
    const float edge_c = b.x * a.y - b.y * a.x;
    const bool inside = (edge_a >= 0.0f && edge_b >= 0.0f && edge_c >= 0.0f) ||
                        (edge_a <= 0.0f && edge_b <= 0.0f && edge_c <= 0.0f);
    const float area = edge_a + edge_b + edge_c;
    if (!inside || area == 0.0f) {
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
