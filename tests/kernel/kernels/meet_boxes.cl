// meets_aabb: ray i against box i.
//
// rays[count]                          t_max is the limit that a traversal would pass
// boxes[count]                         six floats: aabb_min, aabb_max
// is_met[count], t_nears[count]        written; 1 or 0, and t at which the ray enters

#include "boxes/aabb.cl"

kernel void meet_boxes(
    const global packed_ray_t *restrict rays, const global float *restrict boxes, global int *restrict is_met,
    global float *restrict t_nears, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    const padded_ray_t padded = pad_ray(&ray);
    float t_near;
    is_met[i] = meets_aabb(vload3(2 * i, boxes), vload3(2 * i + 1, boxes), &padded, ray.t_max, &t_near);
    t_nears[i] = t_near;
}
