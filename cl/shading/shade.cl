// Colours of surfaces and of the background, from 0 to 1: sRGB, or measurements in the shadings `normal` and `depth`.

#include "structs.cl"
#include "math/vectors.cl"

// The cube root of numbers from 0.001 to 1. The bits of a float are nearly its logarithm: a third of them gives a first
// value with an error of at most 6 %. Each of two steps of Halley's method leaves less than the cube of the error.
INLINED float3 cube_root(const float3 x)
{
    const float3 bits = convert_float3(as_int3(x)) * (1.0f / 3.0f) + (float)(2.0f / 3.0f * 0x3f800000);
    float3 root = as_float3(convert_int3(bits));
    for (int step = 0; step < 2; step++) {
        const float3 cube = root * root * root;
        root *= (cube + 2.0f * x) / (2.0f * cube + x);
    }
    return root;
}

// Encodes linear light as sRGB (IEC 61966-2-1). The exponent 1 / 2.4 is computed as 1 / 4 + 1 / 6: pow takes longer
// than tracing the ray.
INLINED float3 encode_srgb(const float3 linear)
{
    const float3 clamped = clamp(linear, 0.0031308f, 1.0f);
    const float3 root = sqrt(clamped);
    const float3 curved = 1.055f * sqrt(root) * cube_root(root) - 0.055f;
    return linear <= 0.0031308f ? 12.92f * linear : curved;
}

// The background's linear light: a vertical gradient.
INLINED float3 find_background(const global view_t *view, const int row)
{
    const float down = (row + 0.5f) / view->height;
    return blend(load3(view->background_top), load3(view->background_bottom), down);
}

// The background's colour; black in the shadings whose colours are measurements.
INLINED float3 shade_background(const global view_t *view, const int row)
{
    if (view->shading == SHADE_NORMAL || view->shading == SHADE_DEPTH) {
        return (float3)(0.0f);
    }
    return encode_srgb(find_background(view, row));
}

// A diffuse surface under a directed light and ambient light from the sky and the ground.
INLINED float3 shade_lambert(
    const global view_t *view, const float3 surface_colour, const float3 normal, const bool is_lit)
{
    const float up = 0.5f + 0.5f * dot_product(normal, load3(view->to_sky));
    float3 light = blend(load3(view->ground_colour), load3(view->sky_colour), up);
    if (is_lit) {
        light += larger(dot_product(normal, load3(view->to_light)), 0.0f) * load3(view->light_colour);
    }
    return encode_srgb(light * surface_colour);
}

// White at depth_near, black at depth_far, and linear between them, so that grey values can be read as distances: along
// the line of sight, or from the eye for cameras that see to the side and behind themselves.
INLINED float3 shade_depth(const global view_t *view, const float3 position)
{
    const float3 way = position - load3(view->eye);
    const bool is_wide = view->projection == PROJECTION_FISHEYE || view->projection == PROJECTION_PANORAMA;
    const float depth = is_wide ? sqrt(dot_product(way, way)) : dot_product(way, load3(view->optical_axis));
    const float fraction = (depth - view->depth_near) / (view->depth_far - view->depth_near);
    return (float3)(1.0f - clamp(fraction, 0.0f, 1.0f));
}

// A surface in the shading of the picture.
INLINED float3 shade_surface(
    const global view_t *view, const float3 surface_colour, const float3 position, const float3 normal,
    const bool is_lit)
{
    switch (view->shading) {
    case SHADE_NORMAL:
        return 0.5f * normal + 0.5f;
    case SHADE_DEPTH:
        return shade_depth(view, position);
    default:
        return shade_lambert(view, surface_colour, normal, is_lit);
    }
}

// The colour as it is stored, and 255 where something is hit.
INLINED uchar4 as_pixel(const float3 colour, const bool is_hit)
{
    return (uchar4)(convert_uchar3_sat_rte(255.0f * colour), is_hit ? 255 : 0);
}
