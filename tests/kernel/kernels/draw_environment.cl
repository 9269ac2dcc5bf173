// Draws directions to the light of an environment, and finds light and densities of given directions.
//
// numbers[n]           the number of the sampler
// given[n]             float3: unit vectors
// drawn[n]             float8: direction, radiance, density, and the density of the direction by the other way
// found[n]             float4: light and density of the given direction

#include "film/lights.cl"

kernel void draw_environment(
    const global uint *restrict numbers, const global float *restrict given, const global view_t *restrict view,
    const global float *restrict environment, const global float *restrict environment_rows,
    const global float *restrict environment_columns, global float8 *restrict drawn, global float4 *restrict found,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const lights_t lights = {0, 0, environment, environment_rows, environment_columns};
    sobol_sampler_t sampler = make_sampler(numbers[i], 0, 1);
    light_sample_t light;
    drawn[i] = (float8)(0.0f);
    if (sample_light(&lights, view, (float3)(0.0f), &sampler, &light)) {
        const float other = environment_density(&lights, view, light.direction);
        drawn[i] = (float8)(light.direction, light.radiance, light.density, other);
    }
    const float3 direction = load3(given + 3 * i);
    found[i] = (float4)(
        environment_light(&lights, view, direction), environment_density(&lights, view, direction));
}
