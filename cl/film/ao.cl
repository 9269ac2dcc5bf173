// The shading `ao`: the share of the hemisphere above a surface from which light comes, white where it is open.

#include "film/ground.cl"
#include "film/openness.cl"
#include "sampling/warps.cl"

INLINED float4 find_sample(
    const stage_t *stage, const world_ray_t *ray, const int row, sobol_sampler_t *sampler, ray_hits_t *hits)
{
    shown_t shown;
    if (!find_shown(stage, ray, true, sampler, &shown, hits)) {
        return sample_of_background(stage->view, row, 0.0f);
    }
    position_t above = shown.surface.above;
    above.high += shown.appearance.lift;
    const float3 around = sample_hemisphere(sample_2d(sampler));
    const bool is_exposed = is_open(stage, above, shown.appearance.smooth_normal, around, sampler);
    return (float4)((float3)(is_exposed ? 1.0f : 0.0f), 1.0f);
}
