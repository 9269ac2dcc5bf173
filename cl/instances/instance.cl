// A ray in a scene, and its way into an instance.
//
// An instance may be small beside the scene, or far from the ray's origin. So the ray has pairs of floats, high and
// low: it is moved to the instance in pairs, and only what is left, of the instance's own size, is rounded to float32.
// The direction keeps the length that the linear part gives it, so that t is the same on both sides.

#include "exact/ray.cl"
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
#if EXACT
    // The same ray in doubles.
    double3 exact_origin;
    double3 exact_direction;
    exact_shapes_t shapes;
#endif
} ray_pair_t;

// The ray in float32, as the boxes of instances are tested.
INLINED ray_t rounded_ray(const ray_pair_t *ray)
{
    return make_ray(ray->origin, ray->direction, ray->t_min, ray->t_max);
}

#if EXACT

INLINED float3 as_floats(const double3 v)
{
    return (float3)((float)v.x, (float)v.y, (float)v.z);
}

INLINED ray_pair_t make_exact_pair(
    const double3 origin, const double3 direction, const float t_min, const float t_max, const uint mask)
{
    ray_pair_t pair;
    pair.origin = as_floats(origin);
    pair.direction = as_floats(direction);
    pair.t_min = t_min;
    pair.t_max = t_max;
    pair.origin_low = as_floats(origin - convert_double3(pair.origin));
    pair.direction_low = as_floats(direction - convert_double3(pair.direction));
    pair.mask = mask;
    pair.exact_origin = origin;
    pair.exact_direction = direction;
    return pair;
}

INLINED ray_pair_t unpack_ray_pair(const global packed_ray_t *packed, const global ray_rest_t *rest)
{
    return make_exact_pair(
        load_double3(rest->origin), load_double3(rest->direction), packed->t_min, packed->t_max, rest->mask);
}

#else

INLINED ray_pair_t unpack_ray_pair(const global packed_ray_t *packed, const global ray_rest_t *low)
{
    const ray_pair_t pair = {
        load3(packed->origin), load3(packed->direction), packed->t_min, packed->t_max, load3(low->origin),
        load3(low->direction), low->mask};
    return pair;
}

#endif

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

#if EXACT

// No point of a shape is farther from its zero, in its local coordinates.
#define MOST_RADIUS 1.75

// As enter_instance, in doubles: each component of the ray in float32 has one rounding. Also of a lone shape.
INLINED ray_t enter_exactly(const ray_pair_t *outside, const int instance_id, const float t_max)
{
    const global exact_instance_t *instance = outside->shapes.instances + instance_id;
    const double3 centre = load_double3(instance->centre);
    double3 start = transform_exactly(instance->to_object, outside->exact_origin - centre);
    const double3 direction = transform_exactly(instance->to_object, outside->exact_direction);
    const double reach = instance->stretch * (largest_size(outside->exact_origin) + largest_size(centre));
    const float blur = (float)(instance->rounding * (largest_size(start) + reach));
    double t_shift = 0.0;
    if (largest_size(start) > FAR_RADII * MOST_RADIUS) {
        const double square = dot3(direction, direction);
        const double t_closest = -dot3(start, direction) / square;
        const double advance = t_closest - t_closest * SHARE_BEFORE - RADII_BEFORE * MOST_RADIUS / sqrt(square);
        if (advance > 0.0) {
            start = start + advance * direction;
            t_shift = advance;
        }
    }
    ray_t ray = make_ray(
        as_floats(start), as_floats(direction), (float)most_of(outside->t_min - t_shift, 0.0),
        (float)(t_max - t_shift));
    ray.exact.origin = outside->exact_origin;
    ray.exact.direction = outside->exact_direction;
    ray.exact.t_shift = t_shift;
    ray.exact.blur = blur;
    ray.exact.shapes = outside->shapes;
    ray.exact.instance = instance;
    return ray;
}

#endif
