// Packs rays that are in arrays on the device.
//
// Shared arguments: see cl/rays/arrays.cl.
// box[7]              of the world: the centre, half the size along each axis, and the scale, see `TreeBox`
// rays[ray_count]     written: the world's local coordinates
// lows[ray_count]     written: what float32 has rounded off; NULL with a lone shape
// bad                 lowered to the number of a ray that is not finite, has no direction, or is too far
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "rays/store.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

kernel void pack_rays(
    ARRAY_ARGUMENTS, const global double *restrict box, global packed_ray_t *restrict rays,
    global ray_rest_t *restrict lows, global int *restrict bad)
{
    const int index = get_global_id(0);
    if (index >= ray_count) {
        return;
    }
    const ray_arrays_t arrays = ARRAYS;
    const ray_place_t place = find_ray_place(&arrays, index);
    wide_ray_t ray = load_wide_ray(&arrays, &place);
    const tree_box_t tree_box = load_tree_box(box);
    if (localize_ray(&ray, &tree_box) == BAD_RAY) {
        atomic_min(bad, index);
        return;
    }
    store_ray(&ray, load_mask(&arrays, &place), rays + index, lows ? lows + index : 0);
}
