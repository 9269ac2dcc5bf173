// The ray of a pixel in a scene, in pairs of floats: instances may be far from the eye, and seen through a long lens.

#include "instances/instance.cl"
#include "rays/camera.cl"

// Pictures show all instances but those that no ray sees.
#define PICTURE_MASK 0xffffffffu

// The direction has length 1, so t is a distance in local units. What float32 rounds off the place of the pixel is far
// below its size, and has no pair.
INLINED scene_ray_pair_t scene_primary_ray(const global view_t *view, const int column, const int row)
{
    const float2 centre = pixel_centre(view, column, row);
    float3 sum_low, unit_low;
    const float3 direction = add_exactly(
        load3(view->forward), centre.x * load3(view->right) + centre.y * load3(view->up), &sum_low);
    const float3 low = load3(view->forward_low) + sum_low;

    const float scale = unit_scale(direction);
    const float3 scaled = scale * direction;
    const float to_unit = scale / sqrt(dot_product(scaled, scaled));
    const float3 unit = multiply_exactly(to_unit, direction, &unit_low);
    const scene_ray_pair_t ray = {
        load3(view->eye), unit, 0.0f, INFINITY, load3(view->eye_low), unit_low + to_unit * low, PICTURE_MASK};
    return ray;
}
