// The nearest hit of each ray.
//
// nodes[node_count], triangles[triangle_count]   the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// hits[ray_count]                                written; t in units of the ray's direction

#include "traverse.cl"

kernel void closest_hit(
    const global bvh2_node_t *restrict nodes, const global triangle_t *restrict triangles, const int triangle_count,
    const global ray_t *restrict rays, global hit_t *restrict hits, const int ray_count)
{
    const int ray = get_global_id(0);
    if (ray >= ray_count) {
        return;
    }
    const path_t path = load_path(rays + ray);
    const crossing_t nearest = traverse(nodes, triangles, triangle_count, &path, false);
    hits[ray] = as_hit(&nearest);
}
