// load_path and permute_axes: what traversal derives from a ray.
//
// rays[count]
// origins[count], directions[count], inverses[count], shears[count]    written; three floats each
// limits[count]                                                         written; t_min, t_max
// axes[count]                                                           written; 0, 1 or 2
// turned[count]                                                         written; (1, 2, 3) as permuted for the ray

#include "ray.cl"

kernel void derive_path(
    const global ray_t *restrict rays, global float *restrict origins, global float *restrict directions,
    global float *restrict inverses, global float *restrict shears, global float2 *restrict limits,
    global int *restrict axes, global float *restrict turned, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    vstore3(path.origin, i, origins);
    vstore3(path.direction, i, directions);
    vstore3(path.inverse, i, inverses);
    vstore3(path.shear, i, shears);
    limits[i] = (float2)(path.t_min, path.t_max);
    axes[i] = path.axis;
    vstore3(permute_axes((float3)(1.0f, 2.0f, 3.0f), path.axis), i, turned);
}
