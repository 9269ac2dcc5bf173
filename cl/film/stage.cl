// What the samples of a picture are taken of: the world, how it looks, and its light; and the search for the surface
// that a ray shows.
//
// HAS_CUTOUTS, if defined as 1: some surface may have an alpha below 1, and rays pass through it; the view tells.
// HAS_WIREFRAME: see film/wireframe.cl.

#include "looks/looks.cl"
#include "sampling/sampler.cl"
#include "world/cut.cl"
#include "world/surface.cl"

typedef struct {
    world_t world;
    looks_t looks;
    const global view_t *view;
} stage_t;

// What a ray shows.
typedef struct {
    world_surface_t surface;
    appearance_t appearance;
} shown_t;

// The hits of a ray: with no regard to alpha, and, for lines on it, that of the surface that it shows.
typedef struct {
    search_t first;
#if HAS_WIREFRAME
    search_t shown;
#endif
} ray_hits_t;

INLINED ray_hits_t make_ray_hits(void)
{
#if HAS_WIREFRAME
    const ray_hits_t hits = {make_search(1, 0), make_search(1, 0)};
#else
    const ray_hits_t hits = {make_search(1, 0)};
#endif
    return hits;
}

#if HAS_CUTOUTS

// Surfaces that a ray passes through at most; the last one stops it.
#define MOST_LAYERS 64

// Finds the first surface along a ray that stops it. A share of the rays passes through a surface with an alpha of less
// than 1. Returns whether there is one.
CALLED bool find_shown(
    const stage_t *stage, const world_ray_t *ray, const bool is_primary, sobol_sampler_t *sampler, shown_t *shown,
    ray_hits_t *hits)
{
    world_ray_t rest = *ray;
    const float3 direction = ray->direction;
    for (int layer = 0; layer < MOST_LAYERS; layer++) {
        search_t search = make_search(1, 0);
        traverse_shown(&stage->world, stage->view, &rest, is_primary, is_primary && layer == 0, &search);
        if (layer == 0) {
            hits->first = search;
        }
        if (!is_found(&search.nearest)) {
            return false;
        }
        shown->surface = world_surface_at(&stage->world, &rest, &search);
        shown->appearance = appearance_at(&stage->looks, &stage->world, &search, &shown->surface, direction);
        // Between corners whose alpha is 1 it may be a little less.
        const float alpha = stage->view->has_cutouts ? shown->appearance.alpha : 1.0f;
        if (alpha >= 1.0f || layer == MOST_LAYERS - 1 || (alpha > 0.0f && sample_1d(sampler) < alpha)) {
#if HAS_WIREFRAME
            hits->shown = search;
#endif
            return true;
        }
        // The way that is left is a little longer than it should be where t_max ends a ray between two surfaces; both
        // uses of it, the light and the reach of occlusion, have none there.
        const float left = rest.t_max - search.nearest.t;
        rest = make_world_ray(shown->surface.below, direction, (float3)(0.0f), larger(left, 0.0f));
    }
    return false;
}

#else

CALLED bool find_shown(
    const stage_t *stage, const world_ray_t *ray, const bool is_primary, sobol_sampler_t *sampler, shown_t *shown,
    ray_hits_t *hits)
{
    search_t search = make_search(1, 0);
    traverse_shown(&stage->world, stage->view, ray, is_primary, is_primary, &search);
    hits->first = search;
    if (!is_found(&search.nearest)) {
        return false;
    }
#if HAS_WIREFRAME
    hits->shown = search;
#endif
    const float3 direction = ray->direction;
    shown->surface = world_surface_at(&stage->world, ray, &search);
    shown->appearance = appearance_at(&stage->looks, &stage->world, &search, &shown->surface, direction);
    return true;
}

#endif

// Whether anything stops the light between a position and t_max along a direction.
INLINED bool is_shaded(
    const stage_t *stage, const position_t from, const float3 direction, const float t_max, sobol_sampler_t *sampler)
{
#if HAS_CUTOUTS
    if (stage->view->has_cutouts) {
        const world_ray_t ray = make_world_ray(from, direction, (float3)(0.0f), t_max);
        shown_t shown;
        ray_hits_t hits;
        return find_shown(stage, &ray, false, sampler, &shown, &hits);
    }
#endif
    return is_blocked(&stage->world, from, direction, t_max);
}
