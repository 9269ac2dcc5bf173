// The ray of a pixel in a scene, in pairs of floats: instances may be far from the eye, and seen through a long lens.

#include "instances/instance.cl"
#include "rays/camera.cl"

// Pictures show all instances but those that no ray sees.
#define PICTURE_MASK 0xffffffffu

// The direction has length 1, so t is a distance in local units.
INLINED scene_ray_pair_t scene_primary_ray(const global view_t *view, const int column, const int row)
{
    float3 origin, origin_low, direction, direction_low;
    const bool is_seen = camera_ray(
        view, pixel_centre(view, column, row), LENS_CENTRE, &origin, &origin_low, &direction, &direction_low);
    const scene_ray_pair_t ray = {
        origin, direction, 0.0f, is_seen ? INFINITY : NO_RANGE, origin_low, direction_low, PICTURE_MASK};
    return ray;
}
