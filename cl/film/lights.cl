// Light that shines on surfaces: emitting primitives, drawn in proportion to their power, the directed light of the
// view, and the environment around all objects.
//
// lights[light_count]                 light_t in the world's local coordinates
// light_shares[light_count]           float: sums of the shares of the lights' power up to each, the last one 1
// environment[3 * width * height]     float: rows of linear red, green, blue from the zenith; NULL: a gradient
// environment_rows[height]            float: sums of the shares of its light up to each row, the last one 1
// environment_columns[width * height] float: the same within each row

#include "film/bsdf.cl"
#include "film/stage.cl"
#include "sampling/frame.cl"
#include "sampling/warps.cl"

typedef struct {
    const global light_t *lights;
    const global float *light_shares;
    const global float *environment;
    const global float *environment_rows;
    const global float *environment_columns;
} lights_t;

// A direction to light.
typedef struct {
    float3 direction;
    float3 radiance;   // divided by the density
    float density;     // per solid angle; 0 where no other way of sampling finds the light
    float distance;
} light_sample_t;

// Largest squared distance from a sphere's centre, in squared radii, of a point inside. The excess over 1 is for points
// on the surface that rounding moved outwards.
#define INSIDE_SHARE 1.001f

// The first index whose sum is above a sample.
INLINED int find_share(const global float *shares, const int count, const float sample)
{
    int begin = 0;
    int end = count - 1;
    while (begin < end) {
        const int middle = (begin + end) / 2;
        if (shares[middle] > sample) {
            end = middle;
        } else {
            begin = middle + 1;
        }
    }
    return begin;
}

INLINED float share_of(const global float *shares, const int index)
{
    return shares[index] - (index > 0 ? shares[index - 1] : 0.0f);
}

// The share of the samples that each source of light gets: the sources that there are get the same.
INLINED float source_share(const global view_t *view)
{
    const int count = (view->has_sun != 0) + (view->light_count > 0) + (view->environment_width > 0);
    return count > 0 ? 1.0f / count : 0.0f;
}

// The place of a direction in the environment: columns and rows from 0 to 1. `level` gets the length of its horizontal
// part, the sine of the angle to the zenith, which 1 - y * y would lose near the poles.
INLINED float2 place_in_environment(const global view_t *view, const float3 direction, float *level)
{
    const float x = dot_product(direction, load3(view->environment_right));
    const float y = dot_product(direction, load3(view->to_sky));
    const float z = dot_product(direction, load3(view->environment_front));
    *level = square_root(x * x + z * z);
    return (float2)(0.5f + arctangent2(x, z) / (2.0f * PI), arctangent2(*level, y) / PI);
}

INLINED float3 environment_texel(const lights_t *lights, const global view_t *view, const int column, const int row)
{
    return load3(lights->environment + 3 * (row * view->environment_width + column));
}

// The light of the environment along a direction.
INLINED float3 environment_light(const lights_t *lights, const global view_t *view, const float3 direction)
{
    const int width = view->environment_width;
    const int height = view->environment_height;
    if (width == 0) {
        const float up = 0.5f + 0.5f * dot_product(direction, load3(view->to_sky));
        return blend(load3(view->background_bottom), load3(view->background_top), up);
    }
    float level;
    const float2 place = place_in_environment(view, direction, &level);
    const float x = place.x * width - 0.5f;
    const float y = place.y * height - 0.5f;
    const int left = (int)round_down(x);
    const int top = (int)round_down(y);
    float3 sum = (float3)(0.0f);
    for (int corner = 0; corner < 4; corner++) {
        const int column = (left + (corner & 1) + width) % width;
        const int row = clamp(top + (corner >> 1), 0, height - 1);
        const float weight =
            (corner & 1 ? x - left : 1.0f - (x - left)) * (corner >> 1 ? y - top : 1.0f - (y - top));
        sum += weight * environment_texel(lights, view, column, row);
    }
    return view->environment_strength * sum;
}

// The density with which sample_light finds a direction in a pixel of the environment; `level` is the sine of its angle
// to the zenith.
INLINED float pixel_density(
    const lights_t *lights, const global view_t *view, const int column, const int row, const float level)
{
    const int width = view->environment_width;
    const int height = view->environment_height;
    const float share =
        share_of(lights->environment_rows, row) * share_of(lights->environment_columns + row * width, column);
    return source_share(view) * share * width * height / (2.0f * PI * PI * larger(level, 1e-6f));
}

// The density with which sample_light finds a direction of the environment.
INLINED float environment_density(const lights_t *lights, const global view_t *view, const float3 direction)
{
    const int width = view->environment_width;
    const int height = view->environment_height;
    if (width == 0) {
        return 0.0f;
    }
    float level;
    const float2 place = place_in_environment(view, direction, &level);
    const int column = min((int)(place.x * width), width - 1);
    const int row = min((int)(place.y * height), height - 1);
    return pixel_density(lights, view, column, row, level);
}

// The density with which sample_light finds a point of an emitting primitive, per solid angle.
INLINED float emitter_density(
    const global view_t *view, const float3 emission, const float distance_squared, const float cosine)
{
    return source_share(view) * luminance(emission) / view->light_power * distance_squared / larger(cosine, 1e-8f);
}

INLINED bool sample_emitter(
    const lights_t *lights, const global view_t *view, const float3 from, const float choice, const float2 sample,
    light_sample_t *found)
{
    const global light_t *light = lights->lights + find_share(lights->light_shares, view->light_count, choice);
    float3 point, normal;
    // A triangle shines to both sides; a sphere, too, but the inside is not seen from outside.
    bool is_two_sided = true;
    if (light->radius > 0.0f) {
        const float3 from_centre = from - load3(light->a);
        is_two_sided = dot_product(from_centre, from_centre) < INSIDE_SHARE * light->radius * light->radius;
        normal = sample_sphere(sample);
        point = load3(light->a) + light->radius * normal;
    } else {
        const float root = square_root(sample.x);
        const float3 ab = load3(light->ab);
        const float3 ac = load3(light->ac);
        point = load3(light->a) + (1.0f - root) * ab + root * sample.y * ac;
        normal = normal_of_edges(ab, ac);
    }
    const float3 way = point - from;
    const float distance_squared = dot_product(way, way);
    if (!(distance_squared > 0.0f)) {
        return false;
    }
    found->distance = square_root(distance_squared);
    found->direction = way / found->distance;
    const float facing = dot_product(normal, found->direction);
    const float cosine = is_two_sided ? absolute(facing) : -facing;
    if (!(cosine > 0.0f)) {
        return false;
    }
    const float3 emission = load3(light->emission);
    found->density = emitter_density(view, emission, distance_squared, cosine);
    found->radiance = emission / found->density;
    return true;
}

INLINED bool sample_environment(
    const lights_t *lights, const global view_t *view, const float2 sample, light_sample_t *found)
{
    const int width = view->environment_width;
    const int height = view->environment_height;
    const int row = find_share(lights->environment_rows, height, sample.y);
    const float row_share = share_of(lights->environment_rows, row);
    const float row_begin = row > 0 ? lights->environment_rows[row - 1] : 0.0f;
    const global float *columns = lights->environment_columns + row * width;
    const int column = find_share(columns, width, sample.x);
    const float column_share = share_of(columns, column);
    const float column_begin = column > 0 ? columns[column - 1] : 0.0f;
    if (!(row_share > 0.0f && column_share > 0.0f)) {
        return false;
    }
    const float longitude =
        (column + limit_share((sample.x - column_begin) / column_share)) / width - 0.5f;
    const float latitude = (row + limit_share((sample.y - row_begin) / row_share)) / height;
    const float2 around = sin_cos_turns(longitude);
    const float2 down = sin_cos_turns(0.5f * latitude);
    found->direction = down.x * around.x * load3(view->environment_right) + down.y * load3(view->to_sky)
        + down.x * around.y * load3(view->environment_front);
    found->distance = INFINITY;
    // Rounding may put the direction into the next pixel, but it was drawn from this one.
    found->density = pixel_density(lights, view, column, row, down.x);
    found->radiance = environment_light(lights, view, found->direction) / found->density;
    return found->density > 0.0f;
}

// Draws a direction to light. Returns whether there is any.
INLINED bool sample_light(
    const lights_t *lights, const global view_t *view, const float3 from, sobol_sampler_t *sampler,
    light_sample_t *found)
{
    const float share = source_share(view);
    float choice = sample_1d(sampler);
    const float2 sample = sample_2d(sampler);
    if (share == 0.0f) {
        return false;
    }
    if (view->has_sun) {
        if (choice < share) {
            const frame_t frame = frame_around(load3(view->to_light));
            const float2 at = view->light_spread * sample_disk(sample);
            found->direction = unit_vector(from_frame(&frame, (float3)(at, 1.0f)));
            found->radiance = PI / share * load3(view->light_colour);
            found->density = 0.0f;
            found->distance = INFINITY;
            return true;
        }
        choice -= share;
    }
    if (view->light_count > 0) {
        if (choice < share || view->environment_width == 0) {
            return sample_emitter(lights, view, from, limit_share(choice / share), sample, found);
        }
    }
    return sample_environment(lights, view, sample, found);
}
