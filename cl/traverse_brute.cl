// No tree: every triangle against every ray. The study's baseline, for small meshes.

#include "hit.cl"
#include "triangle.cl"

// The nearest hit; with `any`, the first one found. `nodes` is not used.
hit_t traverse(
    const global bvh2_node_t *nodes, const global triangle_t *triangles, const int triangle_count,
    const path_t *path, const bool any)
{
    hit_t hit = no_hit();
    for (int i = 0; i < triangle_count; i++) {
        intersect_triangle(triangles + i, path, &hit);
        if (any && is_hit(&hit)) {
            break;
        }
    }
    return hit;
}
