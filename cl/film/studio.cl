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
#define REFLECTED_SHARE 0.35f

// The directed light is weaker than in the shading `lambert`: with the stronger ambient light and the highlights,
// bright surfaces that face it would be white without shape.
#define KEY_FACTOR 0.9f

// What smooth surfaces reflect is brighter than the mean of the sky, as the lamps of a studio are.
#define REFLECTION_FACTOR 2.0f

// The light at the eye is weaker still: no surface is turned away from it.
#define HEADLIGHT_FACTOR 0.6f

// The light of a surface that reflects all is the albedo of a diffuse one, and pi times the value of a highlight.
#define HIGHLIGHT_FACTOR 3.14159265f

// A shadow on the ground is no darker than this share of the background.
#define LIGHT_IN_SHADOW 0.35f

// The sample dimension of the key light; cut-outs take those that follow.
#define KEY_LIGHT_DIMENSION 1024

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
    const float rest = 1.0f - limit_share(cosine);
    const float squared = rest * rest;
    return reflectance + (1.0f - reflectance) * (squared * squared * rest);
}

// The same for the reflection of all around by a rough surface, whose facets are not all seen at the angle of the whole
// (Lagarde, "Adopting a physically based shading model", 2011).
INLINED float3 fresnel_of_rough(const float3 reflectance, const float cosine, const float roughness)
{
    const float rest = 1.0f - limit_share(cosine);
    const float squared = rest * rest;
    const float3 least = (float3)(1.0f - roughness);
    const float3 most = least > reflectance ? least : reflectance;
    return reflectance + (most - reflectance) * (squared * squared * rest);
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
        / (of_light * square_root(of_eye * of_eye * (1.0f - squared) + squared)
           + of_eye * square_root(of_light * of_light * (1.0f - squared) + squared));
    return facets * visibility * of_light;
}

// The light that reaches a place. The two samples of a pair share it where they show the same smooth surface: light
// changes little within a pixel, and the rays to it take more time than those to the surface.
typedef struct {
    bool is_known;
    bool is_lit;      // by the key light
    bool is_exposed;  // to the sky
    int instance_id;
    float3 position;
    float3 normal;
} known_light_t;

// The instance of the ground.
#define GROUND_ID -2

// The cosine of the angle by which normals may differ on one smooth surface: 18 degrees.
#define SMOOTH_COSINE 0.95f

// A second position lies on the smooth surface around the first if the way to it rises by at most this share.
#define SMOOTH_RISE 0.35f

INLINED bool is_known_at(
    const known_light_t *light, const int instance_id, const float3 position, const float3 normal)
{
    if (!light->is_known || light->instance_id != instance_id || dot_product(light->normal, normal) < SMOOTH_COSINE) {
        return false;
    }
    const float3 way = position - light->position;
    const float rise = dot_product(way, light->normal);
    return rise * rise <= SMOOTH_RISE * SMOOTH_RISE * dot_product(way, way);
}

// Finds the light at a place, unless it is known.
INLINED void find_light(
    const stage_t *stage, const int instance_id, const float3 position, const position_t above, const float3 normal,
    const bool may_be_occluded, const bool may_be_shaded, sobol_sampler_t *sampler,
    known_light_t *light)
{
    if (is_known_at(light, instance_id, position, normal)) {
        return;
    }
    light->is_known = true;
    light->instance_id = instance_id;
    light->position = position;
    light->normal = normal;
    // Both directions are drawn before rays are cast: a processor draws the second one while it waits for the tree.
    const global view_t *view = stage->view;
    const float3 around = sample_hemisphere(sample_2d(sampler));
    sampler->dimension = KEY_LIGHT_DIMENSION;
    const float3 to_light = sample_key_light(view, sampler);
    light->is_exposed = !may_be_occluded || is_open(stage, above, normal, around, sampler);
    light->is_lit = view->is_headlight
        || (dot_product(normal, to_light) > 0.0f
            && (!may_be_shaded || !is_shaded(stage, above, to_light, INFINITY, sampler)));
}

INLINED float3 shade_studio(
    const stage_t *stage, const shown_t *shown, const float3 direction, sobol_sampler_t *sampler,
    known_light_t *known)
{
    const global view_t *view = stage->view;
    const appearance_t *look = &shown->appearance;
    const world_surface_t *surface = &shown->surface;
    position_t above = surface->above;
    above.high += look->lift;
    find_light(
        stage, surface->instance_id, surface->position, above, look->smooth_normal, true, true, sampler, known);
    const float3 reflectance =
        blend((float3)(DIELECTRIC_REFLECTANCE), look->base_colour, look->metallic);
    const float3 diffuse = (1.0f - look->metallic) * look->base_colour;

    // The sky, and its reflection: the rougher, the wider.
    const float openness = known->is_exposed ? 1.0f : REFLECTED_SHARE;
    const float facing = -dot_product(look->normal, direction);
    const float3 mirrored = direction + 2.0f * facing * look->normal;
    const float3 glossy = blend(mirrored, look->normal, look->roughness * look->roughness);
    const float3 shine =
        fresnel_of_rough(reflectance, facing, look->roughness) * (1.0f - 0.5f * look->roughness);
    float3 light = diffuse * find_ambient_light(view, look->normal)
        + REFLECTION_FACTOR * shine * find_ambient_light(view, glossy);
    light *= openness;

    const float3 to_light = view->is_headlight ? -direction : load3(view->to_light);
    const float cosine = dot_product(look->normal, to_light);
    if (known->is_lit && cosine > 0.0f) {
        const float3 halfway = unit_vector(to_light - direction);
        const float3 gloss = fresnel(reflectance, dot_product(to_light, halfway))
            * (HIGHLIGHT_FACTOR * highlight(look->roughness, look->normal, to_light, -direction, halfway));
        const float strength = view->is_headlight ? HEADLIGHT_FACTOR : KEY_FACTOR;
        light += strength * load3(view->light_colour) * (diffuse * cosine + gloss);
    }
    return light + look->emission;
}

// Whether rays to the key light may meet the box around the objects, whose middle is `to_objects` from their origin.
INLINED bool may_meet_objects(const global view_t *view, const float3 to_objects)
{
    // Where rays are in the box, the one to the middle of the light is in the box with sides moved outwards by as much
    // as rays spread on the way to the box's far end.
    const float3 to_light = load3(view->to_light);
    const float farthest = dot_product(to_objects, to_light) + view->objects_radius;
    const float3 reach = load3(view->objects_half_size) + view->light_spread * farthest;
    const float3 inverse = 1.0f / to_light;
    const float3 lower = (to_objects - reach) * inverse;
    const float3 upper = (to_objects + reach) * inverse;
    const float3 near = lower < upper ? lower : upper;
    const float3 far = lower < upper ? upper : lower;
    // NaN is a light that is at right angles to an axis, and an origin in the plane of a side: it passes.
    const float begin = larger(near.x, larger(near.y, larger(near.z, 0.0f)));
    return begin <= smaller(far.x, smaller(far.y, smaller(far.z, farthest)));
}

INLINED bool is_ground_known(const known_light_t *known)
{
    return known->is_known && known->instance_id == GROUND_ID;
}

// Finds the light on the ground, which the two samples of a pair share.
INLINED void find_ground_light(
    const stage_t *stage, const ground_t *ground, sobol_sampler_t *sampler, known_light_t *known)
{
    if (is_ground_known(known)) {
        return;
    }
    // Where no object comes near the rays, there is no shadow.
    const global view_t *view = stage->view;
    const float3 to_objects = load3(view->objects_centre) - ground->above.high;
    const float3 beyond = magnitude(to_objects) - load3(view->objects_half_size);
    const float3 gap = beyond > 0.0f ? beyond : (float3)(0.0f);
    const bool may_be_occluded = dot_product(gap, gap) < view->occlusion_reach * view->occlusion_reach;
    const bool may_be_shaded = may_meet_objects(view, to_objects);
    known->is_known = false;
    if (may_be_occluded || may_be_shaded) {
        find_light(
            stage, GROUND_ID, ground->above.high, ground->above, load3(view->ground_normal), may_be_occluded,
            may_be_shaded, sampler, known);
    } else {
        known->is_known = known->is_lit = known->is_exposed = true;
        known->instance_id = GROUND_ID;
    }
}

// How much darker shadows make the background, from 0 to 1.
INLINED float find_ground_shadow(
    const stage_t *stage, const world_ray_t *ray, sobol_sampler_t *sampler, known_light_t *known)
{
    // Most pixels of the ground are in no shadow: their second samples need not know where they are.
    if (is_ground_known(known) && known->is_lit && known->is_exposed) {
        return 0.0f;
    }
    const ground_t ground = find_ground(stage->view, ray);
    if (!ground.is_met) {
        return 0.0f;
    }
    find_ground_light(stage, &ground, sampler, known);
    if (known->is_lit && known->is_exposed) {
        return 0.0f;
    }
    const global view_t *view = stage->view;
    const float3 normal = load3(view->ground_normal);
    const float3 ambient = find_ambient_light(view, normal);
    const float cosine = larger(dot_product(normal, load3(view->to_light)), 0.0f);
    const float key = KEY_FACTOR * cosine * (view->light_colour[0] + view->light_colour[1] + view->light_colour[2]);
    const float all = ambient.x + ambient.y + ambient.z + key;
    const float missing = (known->is_exposed ? 0.0f : all - key) + (known->is_lit ? 0.0f : key);
    return all > 0.0f ? (1.0f - LIGHT_IN_SHADOW) * find_shadow_strength(view, &ground) * missing / all : 0.0f;
}

// The sample of a ray, by one sampler of the surfaces that it passes through and one of light.
INLINED float4 find_studio_sample(
    const stage_t *stage, const world_ray_t *ray, const int row, sobol_sampler_t *layers, sobol_sampler_t *sampler,
    known_light_t *known, ray_hits_t *hits)
{
    shown_t shown;
    if (find_shown(stage, ray, true, layers, &shown, hits)) {
        return (float4)(shade_studio(stage, &shown, ray->direction, sampler, known), 1.0f);
    }
    return sample_of_background(stage->view, row, find_ground_shadow(stage, ray, sampler, known));
}
