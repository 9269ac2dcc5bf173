// The slab test of a ray against one box (Kay and Kajiya, "Ray tracing complex scenes", 1986; Ize, "Robust BVH ray
// traversal", 2013).

#include "boxes/padding.cl"

// A ray as the slab test needs it. The near planes of padded boxes are as far from near_origin as those of boxes
// without padding would be from the origin, and the far planes are so from far_origin.
typedef struct {
    float3 near_origin;
    float3 far_origin;
    float3 inverse;
    float t_min;
} padded_ray_t;

INLINED padded_ray_t pad_ray(const ray_t *ray)
{
    const padding_t padding = find_ray_padding(ray);
    const float3 width = padding.distance + padding.time * magnitude(ray->direction);
    const float3 ahead = ray->inverse < 0.0f ? -width : width;
    const padded_ray_t padded = {ray->origin + ahead, ray->origin - ahead, ray->inverse, ray->t_min};
    return padded;
}

// Returns whether the ray meets the padded box between its t_min and t_max; *t_near is the t at which it enters, which
// is at most that of any triangle in the box.
INLINED bool meets_aabb(
    const float3 aabb_min, const float3 aabb_max, const padded_ray_t *ray, const float t_max, float *t_near)
{
    // A ray parallel to a slab gives infinities of the right signs, and 0 * infinity = NaN for a plane that it lies in.
    // Therefore the sign of the direction selects the near plane, not a comparison of t; and NaN is the first operand
    // of each comparison, where it loses.
    const int3 is_backward = ray->inverse < 0.0f;
    const float3 near = ((is_backward ? aabb_max : aabb_min) - ray->near_origin) * ray->inverse;
    const float3 far = ((is_backward ? aabb_min : aabb_max) - ray->far_origin) * ray->inverse;
    *t_near = larger(near.x, larger(near.y, larger(near.z, ray->t_min)));
    const float t_far = smaller(far.x, smaller(far.y, smaller(far.z, t_max)));
    return *t_near <= t_far * MEETING_GROWTH;
}
