// Rays of the camera at the world. In a scene they are pairs of floats: instances may be far from the eye, and seen
// through a long lens.

#include "rays/camera.cl"
#include "world/world.cl"

// The ray through a point of the picture and a point of the lens, see rays/camera.cl. Its direction has length 1, so t
// is a distance in local units. Returns whether the camera sees anything there.
INLINED bool world_camera_ray(
    const global view_t *view, const float2 film, const float2 lens, world_ray_t *ray)
{
    position_t origin;
    float3 direction, direction_low;
#if !LONE || EXACT
    const bool is_seen = camera_ray(view, film, lens, &origin.high, &origin.low, &direction, &direction_low);
#else
    const bool is_seen = camera_ray(view, film, lens, &origin.high, 0, &direction, 0);
    origin.low = direction_low = (float3)(0.0f);
#endif
    *ray = make_world_ray(origin, direction, direction_low, INFINITY);
    return is_seen;
}
