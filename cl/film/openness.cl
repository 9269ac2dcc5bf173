// Ambient occlusion: whether nearby surfaces keep light off a position.

#include "film/stage.cl"
#include "sampling/frame.cl"
#include "sampling/warps.cl"

// Whether light from nearby reaches a position along a random direction around a normal.
INLINED bool is_open(const stage_t *stage, const position_t above, const float3 normal, sobol_sampler_t *sampler)
{
    const frame_t frame = frame_around(normal);
    const float3 direction = from_frame(&frame, sample_hemisphere(sample_2d(sampler)));
    return !is_shaded(stage, above, direction, stage->view->occlusion_reach, sampler);
}
