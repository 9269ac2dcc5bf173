// Ambient occlusion: whether nearby surfaces keep light off a position.

#include "film/stage.cl"
#include "sampling/frame.cl"

// Whether light from nearby reaches a position along a direction of the hemisphere around z, turned to a normal.
INLINED bool is_open(
    const stage_t *stage, const position_t above, const float3 normal, const float3 around, sobol_sampler_t *sampler)
{
    const frame_t frame = frame_around(normal);
    return !is_shaded(stage, above, from_frame(&frame, around), stage->view->occlusion_reach, sampler);
}
