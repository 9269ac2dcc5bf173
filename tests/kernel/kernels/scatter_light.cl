// The functions of film/bsdf.cl, by row: a sample of the light that a surface scatters, and its value.
//
// materials[8 * count]     float: base colour, metallic, roughness, index of refraction, transmission, 1 on the back
// to_eye[3 * count]        unit vectors
// samples[4 * count]       float: the lobe, two numbers for the direction; the last one is unused
// to_light[3 * count]      unit vectors to evaluate
// drawn[8 * count]         written: direction, weight, density, and 0 for none, 1 above, 2 below the surface
// at_drawn[4 * count]      written: scattered light at the drawn direction, and its density
// at_light[4 * count]      written: the same at to_light

#include "film/bsdf.cl"

kernel void scatter_light(
    const global float *restrict materials, const global float *restrict to_eye, const global float *restrict samples,
    const global float *restrict to_light, global float *restrict drawn, global float *restrict at_drawn,
    global float *restrict at_light, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const global float *material = materials + 8 * i;
    appearance_t look;
    look.base_colour = vload3(0, material);
    look.metallic = material[3];
    look.roughness = material[4];
    look.ior = material[5];
    look.transmission = material[6];
    const float3 eye = vload3(i, to_eye);
    const bsdf_t bsdf = make_bsdf(&look, material[7] != 0.0f, eye);

    scattered_t scattered;
    const global float *sample = samples + 4 * i;
    const bool is_drawn = sample_bsdf(&bsdf, eye, sample[0], (float2)(sample[1], sample[2]), &scattered);
    float density = 0.0f;
    float3 value = (float3)(0.0f);
    if (is_drawn) {
        value = evaluate_bsdf(&bsdf, eye, scattered.direction, &density);
        vstore3(scattered.direction, 0, drawn + 8 * i);
        vstore3(scattered.weight, 0, drawn + 8 * i + 3);
        drawn[8 * i + 6] = scattered.density;
        drawn[8 * i + 7] = scattered.is_below ? 2.0f : 1.0f;
    }
    vstore4((float4)(value, density), i, at_drawn);
    value = evaluate_bsdf(&bsdf, eye, vload3(i, to_light), &density);
    vstore4((float4)(value, density), i, at_light);
}
