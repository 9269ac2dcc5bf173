// The slab test: does a ray meet a box? (Kay and Kajiya, "Ray tracing complex scenes", 1986.)

#include "ray.cl"

// The far side is moved out by the rounding of both sides, so that no rounding can make a ray miss a box that it
// grazes (Ize, "Robust BVH ray traversal", 2013). A side is rounded three times: by a subtraction, by a product, and by
// a division, which OpenCL lets be as far off as five roundings. The other side may be t_max, the t of a triangle:
// there a subtraction and a division, ten roundings of the weighted sum, and a product. A far side behind the origin
// is moved inwards, but t_min >= 0, so the ray cannot meet that box.
#define SLAB_SLACK (1.0f + ERROR_BOUND(7 + 17))

// Returns whether the ray meets the box between path.t_min and t_max; *entry is where it enters.
INLINED bool meets_aabb(const float3 aabb_min, const float3 aabb_max, const path_t *path, const float t_max, float *entry)
{
    // A ray parallel to a slab gives infinities of the right signs, and 0 * infinity = NaN on a side that it lies in.
    // So the direction says which side is the near one, not a comparison; and NaN comes first in each comparison,
    // where it loses: a ray in a box's face is inside the slab.
    const float3 near = ((path->inverse < 0.0f ? aabb_max : aabb_min) - path->origin) * path->inverse;
    const float3 far = ((path->inverse < 0.0f ? aabb_min : aabb_max) - path->origin) * path->inverse;
    *entry = larger(near.x, larger(near.y, larger(near.z, path->t_min)));
    const float leave = smaller(far.x, smaller(far.y, smaller(far.z, t_max)));
    return *entry <= leave * SLAB_SLACK;
}
