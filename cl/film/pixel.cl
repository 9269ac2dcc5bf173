// The ray of one sample of a pixel.
//
// Samples are spread over the pixel and its neighbours by a tent filter of two pixels' width: each counts the same, and
// there are more of them near the centre. All are moved so that sample 0 is the centre of the pixel and of the lens:
// the hits of a picture are its.

#include "sampling/sampler.cl"
#include "sampling/warps.cl"
#include "world/camera.cl"

// A point in the unit square, moved around its edges so that `origin` becomes the middle.
INLINED float2 centre_on(const float2 point, const float2 origin)
{
    const float2 moved = point - origin + 0.5f;
    return moved - floor(moved);
}

// Returns whether the camera sees anything there.
INLINED bool sample_pixel(
    const global view_t *view, const int column, const int row, sobol_sampler_t *sampler, world_ray_t *ray)
{
    sobol_sampler_t first = make_sampler(row * view->width + column, 0, view->seed);
    const float2 offset = sample_tent_2d(centre_on(sample_2d(sampler), sample_2d(&first)));
    const float2 lens = centre_on(sample_2d(sampler), sample_2d(&first));
    const float2 film = (float2)(
        (2.0f * (column + offset.x) + 1.0f) / view->width - 1.0f,
        1.0f - (2.0f * (row + offset.y) + 1.0f) / view->height);
    return world_camera_ray(view, film, lens, ray);
}
