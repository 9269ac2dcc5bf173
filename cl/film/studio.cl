// The shading `studio`: a soft key light, light from a sky and from the ground that nearby surfaces keep off, and a
// highlight; no light is reflected from one surface to another.

#include "film/ground.cl"
#include "film/openness.cl"
#include "film/stage.cl"
#include "sampling/frame.cl"
#include "sampling/warps.cl"

// The reflectance of surfaces that are no metal, seen at a right angle: that of an index of refraction of 1.5.
#define DIELECTRIC_REFLECTANCE 0.04f

// The share of the ambient light that still reaches surfaces whose hemisphere is full of others: what those reflect.
#define REFLECTED_SHARE 0.25f

// The light from the sky or from the ground along a direction.
INLINED float3 find_ambient_light(const global view_t *view, const float3 direction)
{
    const float up = 0.5f + 0.5f * dot_product(direction, load3(view->to_sky));
    return blend(load3(view->ground_colour), load3(view->sky_colour), up);
}

// A direction to the key light, which has a disk's size.
INLINED float3 sample_key_light(const global view_t *view, sobol_sampler_t *sampler)
{
    const float3 to_light = load3(view->to_light);
    const frame_t frame = frame_around(to_light);
    const float2 at = view->light_spread * sample_disk(sample_2d(sampler));
    return unit_vector(to_light + at.x * frame.tangent + at.y * frame.bitangent);
}

// The fifth power, with which reflectance grows towards grazing angles (Schlick, "An inexpensive BRDF model for
// physically-based rendering", 1994).
INLINED float3 fresnel(const float3 reflectance, const float cosine)
{
    const float rest = 1.0f - clamp(cosine, 0.0f, 1.0f);
    const float squared = rest * rest;
    return reflectance + (1.0f - reflectance) * (squared * squared * rest);
}

// The distribution of microfacets of GGX and its visibility, for light that is reflected to the eye (Walter et al.,
// "Microfacet models for refraction through rough surfaces", 2007).
INLINED float highlight(
    const float roughness, const float3 normal, const float3 to_light, const float3 to_eye, const float3 halfway)
{
    const float alpha = larger(roughness * roughness, 0.002f);
    const float squared = alpha * alpha;
    const float of_half = larger(dot_product(normal, halfway), 0.0f);
    const float of_light = larger(dot_product(normal, to_light), 1e-4f);
    const float of_eye = larger(dot_product(normal, to_eye), 1e-4f);
    const float spread = of_half * of_half * (squared - 1.0f) + 1.0f;
    const float facets = squared / (3.14159265f * spread * spread);
    const float visibility = 0.5f
        / (of_light * sqrt(of_eye * of_eye * (1.0f - squared) + squared)
           + of_eye * sqrt(of_light * of_light * (1.0f - squared) + squared));
    return facets * visibility * of_light;
}

INLINED float3 shade_studio(
    const stage_t *stage, const shown_t *shown, const float3 direction, sobol_sampler_t *sampler)
{
    const global view_t *view = stage->view;
    const appearance_t *look = &shown->appearance;
    const position_t above = shown->surface.above;
    const float3 reflectance =
        blend((float3)(DIELECTRIC_REFLECTANCE), look->base_colour, look->metallic);
    const float3 diffuse = (1.0f - look->metallic) * look->base_colour;

    // The sky, and its reflection: the rougher, the wider.
    const bool is_exposed = is_open(stage, above, look->normal, sampler);
    const float openness = is_exposed ? 1.0f : REFLECTED_SHARE;
    const float facing = -dot_product(look->normal, direction);
    const float3 mirrored = direction + 2.0f * facing * look->normal;
    const float3 glossy = unit_vector(blend(mirrored, look->normal, look->roughness * look->roughness));
    const float3 shine = fresnel(reflectance, facing) * (1.0f - 0.5f * look->roughness);
    float3 light = diffuse * find_ambient_light(view, look->normal) + shine * find_ambient_light(view, glossy);
    light *= openness;

    const float3 to_light = sample_key_light(view, sampler);
    const float cosine = dot_product(look->normal, to_light);
    if (cosine > 0.0f && dot_product(shown->surface.normal, to_light) > 0.0f
        && !is_shaded(stage, above, to_light, INFINITY, sampler)) {
        const float3 halfway = unit_vector(to_light - direction);
        const float3 gloss = fresnel(reflectance, dot_product(to_light, halfway))
            * highlight(look->roughness, look->normal, to_light, -direction, halfway);
        light += load3(view->light_colour) * (diffuse * cosine + gloss);
    }
    return light + look->emission;
}

// How much darker shadows make the background, from 0 to 1.
INLINED float find_ground_shadow(const stage_t *stage, const ground_t *ground, sobol_sampler_t *sampler)
{
    const global view_t *view = stage->view;
    const float3 normal = load3(view->ground_normal);
    const float3 ambient = find_ambient_light(view, normal);
    const float3 to_light = sample_key_light(view, sampler);
    const float cosine = larger(dot_product(normal, to_light), 0.0f);
    const float key = cosine * (view->light_colour[0] + view->light_colour[1] + view->light_colour[2]);
    const float all = ambient.x + ambient.y + ambient.z + key;
    float missing = 0.0f;
    if (!is_open(stage, ground->above, normal, sampler)) {
        missing += all - key;
    }
    if (key > 0.0f && is_shaded(stage, ground->above, to_light, INFINITY, sampler)) {
        missing += key;
    }
    return all > 0.0f ? ground->strength * missing / all : 0.0f;
}

INLINED float4 find_sample(
    const stage_t *stage, const world_ray_t *ray, const int row, sobol_sampler_t *sampler, search_t *first)
{
    shown_t shown;
    if (find_shown(stage, ray, true, sampler, &shown, first)) {
        return (float4)(shade_studio(stage, &shown, ray->direction, sampler), 1.0f);
    }
    const ground_t ground = find_ground(stage->view, ray);
    const float shadow = ground.strength > 0.0f ? find_ground_shadow(stage, &ground, sampler) : 0.0f;
    return sample_of_background(stage->view, row, shadow);
}
