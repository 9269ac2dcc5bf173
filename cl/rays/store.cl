// Rays of doubles in the form in which kernels cast them.

#include "structs.cl"
#include "rays/pack.cl"
#include "exact/ray.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// Stores a ray that `localize_ray` has brought to the world.
//
// rest                written: what float32 has rounded off, and the mask; NULL with a lone shape
INLINED void store_ray(
    const wide_ray_t *ray, const uint mask, global packed_ray_t *packed, global ray_rest_t *rest)
{
#if EXACT
    store_vector(ray->origin, packed->origin, 0);
    store_vector(ray->direction, packed->direction, 0);
    vstore3(ray->origin, 0, rest->origin);
    vstore3(ray->direction, 0, rest->direction);
#else
    store_vector(ray->origin, packed->origin, rest ? rest->origin : 0);
    store_vector(ray->direction, packed->direction, rest ? rest->direction : 0);
#endif
    packed->t_min = (float)ray->t_min;
    packed->t_max = (float)ray->t_max;
    if (rest) {
        rest->mask = mask;
    }
}
