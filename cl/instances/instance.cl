// A ray in a scene, and its way into an instance.
//
// An instance may be small beside the scene, or far from the ray's origin. So the ray has pairs of floats, high and
// low: it is moved to the instance in pairs, and only what is left, of the instance's own size, is rounded to float32.
// The direction keeps the length that the linear part gives it, so that t is the same on both sides.

#include "math/pairs.cl"
#include "math/vectors.cl"
#include "rays/ray.cl"

// How far before the instance, in radii, and in shares of the way to it for the rounding of that.
#define RADII_BEFORE 4.0f
#define SHARE_BEFORE 0x1p-20f

// What a slab test derives from a ray is left to those who need it: of a tile's rays that begin in an instance, nobody.
typedef struct {
    float3 origin;
    float3 direction;
    float t_min;
    float t_max;
    float3 origin_low;
    float3 direction_low;
    uint mask;
} ray_pair_t;

// The ray in float32, as the boxes of instances are tested.
INLINED ray_t rounded_ray(const ray_pair_t *ray)
{
    return make_ray(ray->origin, ray->direction, ray->t_min, ray->t_max);
}

INLINED ray_pair_t unpack_ray_pair(const global packed_ray_t *packed, const global ray_low_t *low)
{
    const ray_pair_t pair = {
        load3(packed->origin), load3(packed->direction), packed->t_min, packed->t_max, load3(low->origin),
        load3(low->direction), low->mask};
    return pair;
}

INLINED float3 transform_vector(const global float rows[3][3], const float3 v)
{
    return (float3)(
        dot_product(load3(rows[0]), v), dot_product(load3(rows[1]), v), dot_product(load3(rows[2]), v));
}

// Returns the ray in the geometry's local coordinates. Its t is that of the ray outside less *t_shift, which is not
// negative.
INLINED ray_t enter_instance(
    const ray_pair_t *outside, const global instance_t *instance, const float t_max, float *t_shift)
{
    float3 low;
    const float3 difference = add_exactly(outside->origin, -load3(instance->centre), &low);
    // Where the two are close, the low parts are as large as the difference, and either alone says nothing.
    float3 start = add_exactly(difference, low + (outside->origin_low - load3(instance->centre_low)), &low);

    *t_shift = 0.0f;
    const float3 direction = outside->direction;
    const float3 size = magnitude(start);
    if (larger(size.x, larger(size.y, size.z)) > FAR_RADII * instance->radius) {
        // The direction is at least 1 long, so a t of four radii is a distance of four radii or more.
        const float t_closest = -dot_product(start, direction) / dot_product(direction, direction);
        const float advance = t_closest - t_closest * SHARE_BEFORE - RADII_BEFORE * instance->radius;
        if (advance > 0.0f) {
            float3 way_low, sum_low;
            const float3 way = multiply_exactly(advance, direction, &way_low);
            start = add_exactly(start, way, &sum_low);
            low += sum_low + (way_low + advance * outside->direction_low);
            *t_shift = advance;
        }
    }
    return make_ray(
        transform_vector(instance->to_object, start + low), transform_vector(instance->to_object, direction),
        larger(outside->t_min - *t_shift, 0.0f), t_max - *t_shift);
}
