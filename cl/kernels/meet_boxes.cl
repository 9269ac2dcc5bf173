// Where rays enter boxes that are padded as those of a tree: of the shards of a mesh, only some need to be visited.
//
// rays[ray_count]                packed_ray_t: the local coordinates of the boxes
// boxes[box_count][2][3]         lower and upper corners
// entries[ray_count][box_count]  written: the t at which a ray enters a box, INFINITY where it does not meet it
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "boxes/aabb.cl"

kernel void meet_boxes(
    const global packed_ray_t *restrict rays, const int ray_count, const global float *restrict boxes,
    const int box_count, global float *restrict entries)
{
    const int ray_index = get_global_id(0);
    if (ray_index >= ray_count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + ray_index);
    const padded_ray_t padded = pad_ray(&ray);
    for (int box = 0; box < box_count; box++) {
        float t_near;
        const bool is_met = meets_aabb(load3(boxes + 6 * box), load3(boxes + 6 * box + 3), &padded, ray.t_max, &t_near);
        entries[(long)ray_index * box_count + box] = is_met ? t_near : INFINITY;
    }
}
