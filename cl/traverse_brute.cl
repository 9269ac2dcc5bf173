// No tree: every triangle against every ray. The study's baseline, for small meshes.

#include "crossing.cl"
#include "triangle.cl"

// The nearest crossing; with `any`, the first one found. `nodes` is not used.
crossing_t traverse(
    const global bvh2_node_t *nodes, const global triangle_t *triangles, const int triangle_count,
    const path_t *path, const bool any)
{
    crossing_t nearest = no_crossing();
    for (int place = 0; place < triangle_count; place++) {
        intersect_triangle(triangles, place, path, &nearest);
        if (any && is_found(&nearest)) {
            break;
        }
    }
    return nearest;
}
