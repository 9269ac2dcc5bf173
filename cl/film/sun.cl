// The directed light of paths: a disk in the sky that shines evenly, far beyond everything.
//
// Its light on a surface that faces it is PI times the colour, but for what the cosines within the disk leave out. A
// disk without a width has that light, too, and no ray finds it by chance.

#include "structs.cl"
#include "math/vectors.cl"
#include "sampling/frame.cl"
#include "sampling/warps.cl"

#define SUN_PI 3.14159265f

INLINED float3 sample_sun(const global view_t *view, const float2 sample)
{
    const frame_t frame = frame_around(load3(view->to_light));
    return unit_vector(from_frame(&frame, sample_cone(sample, view->sun_width)));
}

// The density of sample_sun; 0 where no other way of sampling finds the disk.
INLINED float sun_density(const global view_t *view)
{
    return view->sun_width > 0.0f ? 1.0f / (2.0f * SUN_PI * view->sun_width) : 0.0f;
}

// Whether a ray that meets nothing shows the disk.
INLINED bool shows_sun(const global view_t *view, const float3 direction)
{
    if (!view->has_sun) {
        return false;
    }
    // The squared chord is 2 (1 - cos), without the rounding of a cosine close to 1.
    const float3 chord = direction - load3(view->to_light);
    return dot_product(chord, chord) < 2.0f * view->sun_width;
}

INLINED float3 sun_radiance(const global view_t *view)
{
    return load3(view->light_colour) / (2.0f * view->sun_width);
}
