// meets_children: ray i against the boxes in node i, with what make_sides derives if that is the root.
//
// rays[count]                          t_max is the limit that a traversal would pass
// nodes[count]
// met[count]                           written; a bit for each child that the ray meets

#include "traverse.cl"

kernel void meet_children(
    const global ray_t *restrict rays, const global node_t *restrict nodes, global uint *restrict met, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    const sides_t sides = make_sides(nodes + i, &path);
    lanes_t entry;
    met[i] = meets_children(nodes + i, &sides, path.t_max * sides.limit_scale, &entry);
}
