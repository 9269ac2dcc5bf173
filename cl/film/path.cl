// The shading `path`: light along paths from the eye, with light drawn at each surface (Kajiya, "The rendering
// equation", 1986; Veach and Guibas, "Optimally combining sampling techniques for Monte Carlo rendering", 1995).

//
// HAS_GROUND, if defined as 1: there is a ground below all objects, see film/ground_surface.cl.

#include "film/bsdf.cl"
#include "film/lights.cl"
#include "film/stage.cl"
#include "film/sun.cl"
#if HAS_GROUND
#include "film/ground_surface.cl"
#endif
#include "sampling/frame.cl"

// Reflections before paths end by chance. The chance to go on is the throughput times a factor: paths that go on find
// more light than the next ones, which begin at the eye. With a factor of 1, the time to a given error is 1.12 to 1.16.
#define SURE_BOUNCES 3
#define SURVIVAL_FACTOR 3.0f
#define MOST_SURVIVAL 0.95f

// A ray to a point of a light ends just before it.
#define LIGHT_SHARE 0.9999f

// The weight of a sample where a second way of sampling could have found the direction, too: the power heuristic. The
// noise of a Cornell box has 3 % less variance than with the balance heuristic.
INLINED float weigh(const float density, const float other_density)
{
    const float ratio = other_density / density;
    return 1.0f / (1.0f + ratio * ratio);
}

// The random numbers of one reflection, evenly spread in each pair of them.
typedef struct {
    float2 direction;
    float2 on_light;
    float lobe;
    float survival;
    uint light;  // which one
    uint light_rest;  // the bits that follow those of `light`
} bounce_sample_t;

INLINED bounce_sample_t sample_bounce(sobol_sampler_t *sampler)
{
    uint numbers[2 * PAIR_COUNT];
    sample_pairs(sampler, numbers);
    const bounce_sample_t sample = {
        (float2)(as_unit_float(numbers[0]), as_unit_float(numbers[1])),
        (float2)(as_unit_float(numbers[2]), as_unit_float(numbers[3])),
        as_unit_float(numbers[4]), as_unit_float(numbers[5]), numbers[6], numbers[7]};
    return sample;
}

// The light that comes straight from a source to a surface and is scattered to the eye.
INLINED float3 find_direct_light(
    const stage_t *stage, const lights_t *lights, const position_t from, const bsdf_t *bsdf, const frame_t *frame,
    const float3 to_eye, const bounce_sample_t *sample, sobol_sampler_t *sampler)
{
    light_sample_t light;
    if (!sample_light(lights, stage->view, from.high, sample->light, sample->light_rest, sample->on_light, &light)) {
        return (float3)(0.0f);
    }
    float density;
    const float3 scattered = evaluate_bsdf(bsdf, to_eye, to_frame(frame, light.direction), &density);
    if (!(luminance(scattered) > 0.0f)
        || is_shaded(stage, from, light.direction, LIGHT_SHARE * light.distance, sampler)) {
        return (float3)(0.0f);
    }
    float weight = light.density > 0.0f ? weigh(light.density, density) : 1.0f;
#if HAS_GROUND
    if (light.distance == INFINITY) {
        weight *= 1.0f - ground_cover(stage, from, light.direction);
    }
#endif
    return weight * scattered * light.radiance;
}

// The light of what is beyond all surfaces: the environment and, for all rays but those from the eye, the sun.
INLINED float3 find_distant_light(
    const lights_t *lights, const global view_t *view, const float3 direction, const float density,
    const bool is_primary)
{
    const float other = density > 0.0f ? environment_density(lights, view, direction) : 0.0f;
    const float weight = density > 0.0f ? weigh(density, other) : 1.0f;
    float3 light = weight * environment_light(lights, view, direction);
    if (!is_primary && shows_sun(view, direction)) {
        const float of_sun = sun_density(view) * source_share(view);
        light += (density > 0.0f ? weigh(density, of_sun) : 1.0f) * sun_radiance(view);
    }
    return light;
}

// Draws the direction in which the path goes on. Returns whether there is one.
INLINED bool find_next_direction(
    const bsdf_t *bsdf, const frame_t *frame, const float3 geometric_normal, const float3 to_eye,
    const bounce_sample_t *sample, scattered_t *scattered, float3 *next)
{
    if (!sample_bsdf(bsdf, to_eye, sample->lobe, sample->direction, scattered)) {
        return false;
    }
    *next = short_unit_vector(from_frame(frame, scattered->direction));
    // Refraction that the shading normal allows, but not the surface, would stay on this side of it.
    return !(scattered->is_below && dot_product(geometric_normal, *next) > 0.0f);
}

// The light of a sample, limited to what the picture asks for; its colour stays.
INLINED float3 limit_sample(const global view_t *view, const float3 light)
{
    const float most = larger(light.x, larger(light.y, light.z));
    return most > view->most_light ? view->most_light / most * light : light;
}

INLINED float4 find_path_sample(
    const stage_t *stage, const lights_t *lights, const world_ray_t *primary, const int row, sobol_sampler_t *sampler,
    ray_hits_t *hits)
{
    const global view_t *view = stage->view;
    world_ray_t ray = *primary;
    float3 throughput = (float3)(1.0f);
    float3 light = (float3)(0.0f);
    float density = 0.0f;  // of the ray's direction; 0 where light is found by this ray alone
    float covered = 1.0f;

    for (int bounce = 0;; bounce++) {
        // Before the surface is known: a processor draws while it waits for the tree.
        const bounce_sample_t sample = sample_bounce(sampler);
        ray_hits_t found = make_ray_hits();
        shown_t shown;
        const float3 direction = ray.direction;
        bool is_hit = find_shown(stage, &ray, bounce == 0, sampler, &shown, &found);
#if HAS_GROUND
        if (!is_hit && find_shown_ground(stage, &ray, sampler, &shown)) {
            is_hit = true;
            if (bounce == 0 && view->is_studio_lit) {
                throughput = show_background_on_ground(view, row);
            }
        }
#endif
        if (bounce == 0) {
            *hits = found;
        }
        if (!is_hit) {
            if (bounce == 0) {
                covered = 0.0f;
            }
            if (bounce == 0 && view->is_studio_lit) {
                return sample_of_background(view, row, 0.0f);
            }
            if (bounce > 0 || !view->is_transparent) {
                light += throughput * find_distant_light(lights, view, direction, density, bounce == 0);
            }
            break;
        }

        const float3 emission = shown.appearance.emission;
        if (luminance(emission) > 0.0f) {
            float weight = 1.0f;
            if (density > 0.0f && shown.appearance.is_light) {
                const float3 way = shown.surface.position - ray.origin;
                weight = weigh(density, found_emitter_density(view, &shown, way));
            }
            light += weight * throughput * emission;
        }
        if (bounce == view->most_bounces) {
            break;
        }

        const frame_t frame = frame_around(shown.appearance.normal);
        const float3 to_eye = to_frame(&frame, -direction);
        const bsdf_t bsdf = make_bsdf(&shown.appearance, shown.surface.is_back, to_eye);
        // As in `studio`, rays begin on the round surface that the facets stand for (Hanika, "Hacking the shadow
        // terminator", Ray Tracing Gems II, 2021): those to the light, and the next one, whose density is that of the
        // same position. A direction into the facet is not refused: the facet stops it, and reflects it once more.
        position_t above = shown.surface.above;
        above.high += shown.appearance.lift;
        // The next direction is drawn before the ray to the light is cast: what both need is not kept meanwhile.
        scattered_t scattered;
        float3 next;
        const bool goes_on =
            find_next_direction(&bsdf, &frame, shown.surface.normal, to_eye, &sample, &scattered, &next);
        light += throughput * find_direct_light(stage, lights, above, &bsdf, &frame, to_eye, &sample, sampler);
        if (!goes_on) {
            break;
        }
        throughput *= scattered.weight;
        density = scattered.density;
        if (bounce >= SURE_BOUNCES) {
            const float most = larger(throughput.x, larger(throughput.y, throughput.z));
            const float survival = smaller(SURVIVAL_FACTOR * most, MOST_SURVIVAL);
            if (!(sample.survival < survival)) {
                break;
            }
            throughput /= survival;
        }
        const position_t origin = scattered.is_below ? shown.surface.below : above;
        ray = make_world_ray(origin, next, (float3)(0.0f), INFINITY);
    }
    return (float4)(limit_sample(view, light), covered);
}
