// The point of a crossing on a sphere, with the surface normal there.

#include "math/vectors.cl"
#include "shading/surface.cl"
#include "spheres/sphere.cl"

// At most seven roundings from the centre to the position: those of the normal's length, a product and a sum; and as
// much again for the test of a ray that leaves the sphere, whose discriminant cancels where the ray is tangential.
#define SPHERE_SURFACE_ERROR ERROR_BOUND(7 + 9)

// The normal follows from the same chord as the crossing, and not from its t: that is rounded relative to the distance
// of the ray's origin, which may be many radii.
INLINED surface_t sphere_surface_at(const ball_t *ball, const bool is_leaving, const ray_t *ray)
{
    chord_t chord;
    find_chord(shear_origin(ball->centre, ray), ball->radius, ray, &chord);
    const float way = is_leaving ? chord.way_out : chord.way_in;
    const float3 from_centre = (float3)(chord.at + way * ray->shear.xy, way);
    const float3 outward = unit_vector(restore_axes(from_centre, ray->axis));
    const float3 arm = ball->radius * outward;

    surface_t surface;
    surface.position = ball->centre + arm;
    surface.error = SPHERE_SURFACE_ERROR * (magnitude(ball->centre) + magnitude(arm));
    surface.normal = is_leaving ? -outward : outward;
    surface.is_back = is_leaving;
    return surface;
}
