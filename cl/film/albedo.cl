// The shading `albedo`: the base colours of surfaces, without light.

#include "film/ground.cl"
#include "film/stage.cl"

INLINED float4 find_sample(
    const stage_t *stage, const world_ray_t *ray, const int row, sobol_sampler_t *sampler, ray_hits_t *hits)
{
    shown_t shown;
    if (!find_shown(stage, ray, true, sampler, &shown, hits)) {
        return sample_of_background(stage->view, row, 0.0f);
    }
    return (float4)(shown.appearance.base_colour, 1.0f);
}
