// The functions of sampling/warps.cl, by row.
//
// samples[count]                      float2: in [0, 1)
// widths[count]                       float: 1 - cosine of the cones
// disks[count], tents[count]          written: float2
// hemispheres[3 * count], cones[3 * count], spheres[3 * count]      written

#include "sampling/warps.cl"

kernel void warp_samples(
    const global float2 *restrict samples, const global float *restrict widths, global float2 *restrict disks,
    global float2 *restrict tents, global float *restrict hemispheres, global float *restrict cones,
    global float *restrict spheres, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    disks[i] = sample_disk(samples[i]);
    tents[i] = sample_tent_2d(samples[i]);
    vstore3(sample_hemisphere(samples[i]), i, hemispheres);
    vstore3(sample_cone(samples[i], widths[i]), i, cones);
    vstore3(sample_sphere(samples[i]), i, spheres);
}
