// The point of a crossing on an instance, with the surface normal there, in the scene's local coordinates.

#include "instances/instance.cl"
#include "shading/surface.cl"

// A point on its way from the geometry to the scene and back has at most 10 roundings: 4 for each linear part, whose
// entries are rounded, too, one where the pair becomes a float, and one where the point is moved above the surface.
#define ROUND_TRIP_ERROR ERROR_BOUND(4 + 4 + 1 + 1)

// And at most 6 of the low parts of pairs, which count where the instance is small beside its distance to zero.
#define PAIR_ERROR (6.0f * ROUNDING * ROUNDING)

typedef struct {
    float3 above;      // a point just above the surface, from which a ray cannot meet the primitive that it leaves
    float3 above_low;  // what float32 has rounded off that
    float3 below;      // the same just below the surface
    float3 below_low;
    float3 normal;     // unit vector on the side of the ray's origin
    bool is_back;      // see surface_t
} instance_surface_t;

// A bound on the magnitude of a transformed vector, of which a bound is known.
INLINED float3 transform_bound(const global float rows[3][3], const float3 bound)
{
    return (float3)(
        dot_product(magnitude(load3(rows[0])), bound), dot_product(magnitude(load3(rows[1])), bound),
        dot_product(magnitude(load3(rows[2])), bound));
}

// Moves a surface from the geometry's local coordinates to the scene's.
INLINED instance_surface_t place_surface(const global instance_t *instance, const surface_t *surface)
{
    const float3 centre = load3(instance->centre);
    const float3 reach = transform_bound(instance->to_world, magnitude(surface->position));
    const float3 error = ROUND_TRIP_ERROR * reach + PAIR_ERROR * (magnitude(centre) + reach);
    surface_t padded = *surface;
    padded.error += transform_bound(instance->to_object, error);

    instance_surface_t placed;
    float3 low;
    placed.above = add_exactly(centre, transform_vector(instance->to_world, point_above(&padded)), &low);
    placed.above_low = low + load3(instance->centre_low);
    placed.below = add_exactly(centre, transform_vector(instance->to_world, point_below(&padded)), &low);
    placed.below_low = low + load3(instance->centre_low);
    placed.is_back = surface->is_back;
    // Normals are transformed by the transpose of the inverse.
    const float3 normal = surface->normal;
    placed.normal = unit_vector(
        normal.x * load3(instance->to_object[0]) + normal.y * load3(instance->to_object[1])
        + normal.z * load3(instance->to_object[2]));
    return placed;
}
