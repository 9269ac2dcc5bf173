// Rays over a surface: the hemisphere around a normal, sampled by its cosine.

#include "structs.cl"
#include "sampling/frame.cl"
#include "sampling/sampler.cl"
#include "sampling/warps.cl"

// Directions that are drawn at a time: a processor draws several at once if nothing comes between them. A kernel with
// 64 takes a tenth less than one that casts each ray when it is drawn; on a 2-core x86-64 server, dragon. On a GPU
// (IS_GPU, see triangles/block.cl) they would lie in slow memory.
#if IS_GPU
#define DRAWN_AT_ONCE 1
#else
#define DRAWN_AT_ONCE 64
#endif

typedef struct {
    float x[DRAWN_AT_ONCE];
    float y[DRAWN_AT_ONCE];
    float z[DRAWN_AT_ONCE];
} directions_t;

// Draws `count` directions, of which samples `first` and following are of one number. They have length 1.
INLINED void draw_directions(
    const global hemisphere_t *hemisphere, const uint seed, const int first, const int count, directions_t *directions)
{
    const frame_t frame = frame_around(load3(hemisphere->normal));
    for (int i = 0; i < count; i++) {
        sobol_sampler_t sampler = make_sampler(hemisphere->number, first + i, seed);
        const float3 direction = from_frame(&frame, sample_hemisphere(sample_2d(&sampler)));
        directions->x[i] = direction.x;
        directions->y[i] = direction.y;
        directions->z[i] = direction.z;
    }
}

INLINED float3 direction_of(const directions_t *directions, const int i)
{
    return (float3)(directions->x[i], directions->y[i], directions->z[i]);
}
