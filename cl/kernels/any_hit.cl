// Whether anything lies on each ray between its t_min and its t_max.
//
// nodes[node_count], triangles[triangle_count]   the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// blocked[ray_count]                             written; 1 or 0

#include "traverse.cl"

kernel void any_hit(
    const global bvh2_node_t *restrict nodes, const global triangle_t *restrict triangles, const int triangle_count,
    const global ray_t *restrict rays, global uchar *restrict blocked, const int ray_count)
{
    const int ray = get_global_id(0);
    if (ray >= ray_count) {
        return;
    }
    const path_t path = load_path(rays + ray);
    const crossing_t blocker = traverse(nodes, triangles, triangle_count, &path, true);
    blocked[ray] = is_found(&blocker);
}
