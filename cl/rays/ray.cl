// A ray in private memory, with the numbers that the box test and the triangle test derive from its direction.

#include "structs.cl"
#include "math/numeric.cl"

// keep: expanded before the branches
#include "exact/ray.cl"

typedef struct {
    float3 origin;
    float3 direction;
    float3 inverse;  // 1 / direction; for a zero, infinity with the sign of the zero
    float3 shear;    // x / z, y / z and 1 / z of the permuted direction, see permute_axes
    int axis;        // the axis of the direction's largest component
    float t_min;
    float t_max;
#if EXACT
    exact_ray_t exact;
#endif
} ray_t;

// Permutes a vector so that component `axis` becomes z. The permutation is cyclic: it keeps orientations.
INLINED float3 permute_axes(const float3 v, const int axis)
{
    return choose3((int3)(axis) == 0, v.yzx, choose3((int3)(axis) == 1, v.zxy, v));
}

// Undoes permute_axes.
INLINED float3 restore_axes(const float3 v, const int axis)
{
    return axis == 0 ? v.zxy : axis == 1 ? v.yzx : v;
}

// Assumes a finite direction of moderate length, 1e-18 to 1e18, and t_min >= 0.
INLINED ray_t make_ray(const float3 origin, const float3 direction, const float t_min, const float t_max)
{
    ray_t ray;
    ray.origin = origin;
    ray.direction = direction;
    ray.t_min = t_min;
    ray.t_max = t_max;
    ray.inverse = 1.0f / direction;

    // Without branches: the axis of the next ray is not foreseen.
    const float3 size = magnitude(direction);
    const int is_y = !(size.x > size.y);
    const int is_z = !(larger(size.x, size.y) > size.z);
    ray.axis = is_z << 1 | (is_y & ~is_z);
    const float3 permuted = permute_axes(direction, ray.axis);
    const float2 slopes = permuted.xy / permuted.z;
    ray.shear = (float3)(slopes, permute_axes(ray.inverse, ray.axis).z);
#if EXACT
    ray.exact.blur = 0.0f;
#endif
    return ray;
}

INLINED ray_t unpack_ray(const global packed_ray_t *packed)
{
    return make_ray(load3(packed->origin), load3(packed->direction), packed->t_min, packed->t_max);
}
