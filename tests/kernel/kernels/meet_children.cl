// meets_children: ray i against the boxes in node i.
//
// rays[count]                          t_max is the limit that a traversal would pass
// nodes[count]
// met[count]                           written; a bit for each child that the ray meets

#include "traversal/traverse.cl"

kernel void meet_children(
    const global packed_ray_t *restrict rays, const global node_t *restrict nodes, global uint *restrict met,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    const slabs_t slabs = make_slabs(&ray);
    lanes_t t_near;
    met[i] = meets_children(nodes + i, &slabs, ray.t_max * slabs.unit, &t_near);
}
