// traverse, told that any crossing will do: which one is it?
//
// rays[count], nodes[node_count], triangles[triangle_count]     in the order that run_shell has
// hits[count]                                                   written

#include "traverse.cl"

kernel void find_any(
    const global ray_t *restrict rays, const global bvh2_node_t *restrict nodes,
    const global triangle_t *restrict triangles, global hit_t *restrict hits, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    const crossing_t found = traverse(nodes, triangles, TRIANGLE_COUNT, &path, true);
    hits[i] = as_hit(&found);
}
