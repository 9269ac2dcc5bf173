// The ray of one sample of a pixel.
//
// Samples are spread over the pixel and its neighbours by a tent filter of two pixels' width: each counts the same, and
// there are more of them near the centre. All pixels have the same pattern, so that edges have no noise; sample 0 is
// the centre of the pixel and of the lens: the hits of a picture are its.

#include "sampling/pattern.cl"
#include "sampling/sampler.cl"
#include "sampling/warps.cl"
#include "world/camera.cl"

// A point in the unit square, moved around its edges so that `origin` becomes the middle.
INLINED float2 centre_on(const float2 point, const float2 origin)
{
    const float2 moved = point - origin + 0.5f;
    return moved - floor(moved);
}

// The point of the lens, by points that are independent of those of the light.
INLINED float2 sample_lens(const global view_t *view, const int pixel, const uint sample)
{
    sobol_sampler_t first = make_sampler(pixel, 0, ~view->seed);
    sobol_sampler_t sampler = make_sampler(pixel, sample, ~view->seed);
    return centre_on(sample_2d(&sampler), sample_2d(&first));
}

// The point of the picture at an offset from the centre of a pixel, as cameras take it, see rays/camera.cl.
INLINED float2 film_point(const global view_t *view, const int column, const int row, const float2 offset)
{
    return (float2)(
        (2.0f * (column + offset.x) + 1.0f) / view->width - 1.0f,
        1.0f - (2.0f * (row + offset.y) + 1.0f) / view->height);
}

// The point of the picture of one sample of a pixel.
INLINED float2 sample_film(const global view_t *view, const int column, const int row, const uint sample)
{
    return film_point(view, column, row, sample_tent_2d(pattern_point(sample)));
}

// Returns whether the camera sees anything there.
INLINED bool sample_pixel(
    const global view_t *view, const int column, const int row, const uint sample, world_ray_t *ray)
{
    const float2 lens = view->has_lens ? sample_lens(view, row * view->width + column, sample) : LENS_CENTRE;
    return world_camera_ray(view, sample_film(view, column, row, sample), lens, ray);
}
