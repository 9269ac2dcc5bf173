// The slab test: does a ray meet a box? (Kay and Kajiya, "Ray tracing complex scenes", 1986.)

#include "ray.cl"

// The far side is moved out by the rounding of both sides, so that no rounding can make a ray miss a box that it
// grazes (Ize, "Robust BVH ray traversal", 2013). A side is rounded three times: by a subtraction, by a product, and by
// a division, which OpenCL lets be as far off as five roundings. The other side may be t_max, the t of a triangle:
// there a subtraction and a division, ten roundings of the weighted sum, and a product.
#define SLAB_SLACK ERROR_BOUND(7 + 17)

// Returns whether the ray meets the box between path.t_min and t_max; *entry is where it enters.
bool meets_aabb(const float3 aabb_min, const float3 aabb_max, const path_t *path, const float t_max, float *entry)
{
    const float3 to_min = (aabb_min - path->origin) * path->inverse;
    const float3 to_max = (aabb_max - path->origin) * path->inverse;
    const float3 near = smaller3(to_min, to_max);
    const float3 far = larger3(to_min, to_max);
    *entry = larger(larger(near.x, near.y), larger(near.z, path->t_min));
    const float leave = smaller(smaller(far.x, far.y), smaller(far.z, t_max));
    // Not leave * (1 + SLAB_SLACK), which would move a far side behind the origin inwards.
    return *entry <= leave + SLAB_SLACK * fabs(leave);
}
