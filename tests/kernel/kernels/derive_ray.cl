// unpack_ray and permute_axes: what traversal derives from a ray.
//
// rays[count]
// origins[count], directions[count], inverses[count], shears[count]    written; three floats each
// limits[count]                                                         written; t_min, t_max
// axes[count]                                                           written; 0, 1 or 2
// permuted[count]                                                         written; (1, 2, 3) as permuted for the ray

#include "rays/ray.cl"

kernel void derive_ray(
    const global packed_ray_t *restrict rays, global float *restrict origins, global float *restrict directions,
    global float *restrict inverses, global float *restrict shears, global float2 *restrict limits,
    global int *restrict axes, global float *restrict permuted, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    vstore3(ray.origin, i, origins);
    vstore3(ray.direction, i, directions);
    vstore3(ray.inverse, i, inverses);
    vstore3(ray.shear, i, shears);
    limits[i] = (float2)(ray.t_min, ray.t_max);
    axes[i] = ray.axis;
    vstore3(permute_axes((float3)(1.0f, 2.0f, 3.0f), ray.axis), i, permuted);
}
