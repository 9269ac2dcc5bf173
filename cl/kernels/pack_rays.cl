// Packs rays that are in arrays on the device.
//
// Shared arguments: see cl/rays/arrays.cl.
// box[7]              of the world: the centre, half the size along each axis, and the scale, see `TreeBox`
// masks[]             of each ray if mask_step is 1, or one for all if it is 0
// rays[ray_count]     written: the world's local coordinates
// lows[ray_count]     written: what float32 has rounded off; NULL with a lone shape
// bad                 lowered to the number of a ray that is not finite, has no direction, or is too far
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "structs.cl"
#include "rays/pack.cl"
#include "exact/ray.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

kernel void pack_rays(
    ARRAY_ARGUMENTS, const global double *restrict box, const global uint *restrict masks, const int mask_step,
    global packed_ray_t *restrict rays, global ray_rest_t *restrict lows, global int *restrict bad)
{
    const int index = get_global_id(0);
    if (index >= ray_count) {
        return;
    }
    wide_ray_t ray = load_wide_ray(
        origins, directions, doubles, axes, axis_count, t_mins, t_maxs, each_limit, index);
    const tree_box_t tree_box = load_tree_box(box);
    if (localize_ray(&ray, &tree_box) == BAD_RAY) {
        atomic_min(bad, index);
        return;
    }
    global packed_ray_t *packed = rays + index;
    global ray_rest_t *low = lows ? lows + index : 0;
#if EXACT
    store_vector(ray.origin, packed->origin, 0);
    store_vector(ray.direction, packed->direction, 0);
    vstore3(ray.origin, 0, low->origin);
    vstore3(ray.direction, 0, low->direction);
#else
    store_vector(ray.origin, packed->origin, low ? low->origin : 0);
    store_vector(ray.direction, packed->direction, low ? low->direction : 0);
#endif
    packed->t_min = (float)ray.t_min;
    packed->t_max = (float)ray.t_max;
    if (low) {
        low->mask = masks[mask_step * index];
    }
}
