// The slab test of a ray against one box (Kay and Kajiya, "Ray tracing complex scenes", 1986).

#include "rays/ray.cl"

// The far plane is moved outwards by the rounding of both planes, so that no rounding makes a ray miss a box that it
// grazes (Ize, "Robust BVH ray traversal", 2013). The t of a plane has seven roundings: one of the subtraction, one of
// the product, and five of the division, whose error OpenCL bounds no tighter. The other operand of the comparison may
// be t_max, the t of a triangle, with up to seventeen: a subtraction and a division, ten of the weighted sum, and a
// product. A far plane behind the origin moves inwards, but t_min >= 0, so the ray cannot meet that box.
#define SLAB_SLACK (1.0f + ERROR_BOUND(7 + 17))

// Returns whether the ray meets the box between ray.t_min and t_max; *t_near is the t at which it enters.
INLINED bool meets_aabb(
    const float3 aabb_min, const float3 aabb_max, const ray_t *ray, const float t_max, float *t_near)
{
    // A ray parallel to a slab gives infinities of the right signs, and 0 * infinity = NaN for a plane that it lies in.
    // Therefore the sign of the direction selects the near plane, not a comparison of t; and NaN is the first operand
    // of each comparison, where it loses: a ray in a face of the box is inside the slab.
    const float3 near = ((ray->inverse < 0.0f ? aabb_max : aabb_min) - ray->origin) * ray->inverse;
    const float3 far = ((ray->inverse < 0.0f ? aabb_min : aabb_max) - ray->origin) * ray->inverse;
    *t_near = larger(near.x, larger(near.y, larger(near.z, ray->t_min)));
    const float t_far = smaller(far.x, smaller(far.y, smaller(far.z, t_max)));
    return *t_near <= t_far * SLAB_SLACK;
}
