// The ground of paths (HAS_GROUND): a matte surface on the plane of film/ground.cl, seen from above, which passes into
// the background towards its radius.
//
// All objects are in front of it: it stops rays that meet no object. As they stand above the plane, that differs from a
// plane among them only for parts that a frame leaves out, see Scene.frame.

#include "film/ground.cl"
#include "film/stage.cl"

// The share of light that it reflects: that of a middle grey card would be 0.18, and that of paper 0.8.
#define GROUND_ALBEDO 0.5f

// The same where the light is that of `studio`, whose surfaces have little light from below.
#define STUDIO_ALBEDO 0.2f

// The share of light that the ground stops where a ray meets it.
INLINED float ground_share(const global view_t *view, const ground_t *ground)
{
    return ground->is_met ? find_shadow_strength(view, ground) : 0.0f;
}

// The share of light that the ground stops on its way to infinity.
INLINED float ground_cover(const stage_t *stage, const position_t from, const float3 direction)
{
    const world_ray_t ray = make_world_ray(from, direction, (float3)(0.0f), INFINITY);
    const ground_t ground = find_ground(stage->view, &ray);
    return ground_share(stage->view, &ground);
}

// Finds the ground along a ray that meets no object. A share of the rays passes through where it fades out. Returns
// whether it stops this one.
INLINED bool find_shown_ground(
    const stage_t *stage, const world_ray_t *ray, sobol_sampler_t *sampler, shown_t *shown)
{
    const global view_t *view = stage->view;
    const ground_t ground = find_ground(view, ray);
    const float share = ground_share(view, &ground);
    if (!(share > 0.0f) || (share < 1.0f && !(sample_1d(sampler) < share))) {
        return false;
    }
    const float3 normal = load3(view->ground_normal);
    // From far away, the point is above or below the plane by the rounding of the way to it.
    const float3 at = ground.above.high;
    const position_t position = {at - dot_product(at - load3(view->ground_point), normal) * normal, (float3)(0.0f)};

    world_surface_t *surface = &shown->surface;
    surface->position = position.high;
    surface->above = surface->below = position;
    surface->normal = normal;
    surface->is_back = false;
    appearance_t *look = &shown->appearance;
    look->normal = look->smooth_normal = normal;
    look->base_colour = (float3)(view->is_studio_lit ? STUDIO_ALBEDO : GROUND_ALBEDO);
    look->lift = look->emission = (float3)(0.0f);
    look->is_light = false;
    look->metallic = look->transmission = 0.0f;
    look->coat_cosine = 0.0f;
    look->alpha = look->roughness = look->ior = 1.0f;
    return true;
}

// The factor of the light of the ground with which it shows the background where nothing is near: that stays as it is
// in `studio`, and has the shadows and the reflected light of paths.
INLINED float3 show_background_on_ground(const global view_t *view, const int row)
{
    // The mean of the cosines to a sky that is weighted by them is 2 / 3.
    const float3 sky = find_ambient_light(view, 2.0f / 3.0f * load3(view->ground_normal));
    const float cosine = larger(dot_product(load3(view->ground_normal), load3(view->to_light)), 0.0f);
    return find_background(view, row) / (STUDIO_ALBEDO * (sky + cosine * load3(view->light_colour)));
}
