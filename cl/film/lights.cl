// Light that shines on surfaces: emitting primitives, drawn in proportion to their power, the directed light of the
// view, and the environment around all objects.
//
// lights[light_count]                 light_t in the world's local coordinates
// light_choices[light_count]          light_choice_t: by the lights' power, see film/choice.cl
// environment[3 * width * height]     float: rows of linear red, green, blue from the zenith; NULL: a gradient
// environment_rows[height]            float: sums of the shares of its light up to each row, the last one 1
// environment_columns[width * height] float: the same within each row

#include "film/bsdf.cl"
#include "film/choice.cl"
#include "film/ground.cl"
#include "film/sphere_lamps.cl"
#include "film/stage.cl"
#include "film/sun.cl"

typedef struct {
    const global light_t *lights;
    const global light_choice_t *light_choices;
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

INLINED int source_count(const global view_t *view)
{
    return (view->has_sun != 0) + (view->light_count > 0) + (view->environment_width > 0);
}

// The share of the samples that each source of light gets: the sources that there are get the same.
INLINED float source_share(const global view_t *view)
{
    const int count = source_count(view);
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
CALLED float3 environment_light(const lights_t *lights, const global view_t *view, const float3 direction)
{
    const int width = view->environment_width;
    const int height = view->environment_height;
    if (view->is_studio_lit) {
        return find_ambient_light(view, direction);
    }
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

// The density with which sample_light finds a point of an emitting triangle, per solid angle; `per_area` is that of
// emitting primitives.
INLINED float emitter_density(
    const global view_t *view, const float per_area, const float distance_squared, const float cosine)
{
    return source_share(view) * per_area * distance_squared / larger(cosine, 1e-8f);
}

// The probability with which sample_light chooses an emitting sphere.
INLINED float sphere_share(const global view_t *view, const float per_area, const float radius)
{
    return source_share(view) * per_area * (4.0f * PI * radius * radius);
}

// The density with which sample_light finds the point of an emitting primitive that a ray has met; `way` is from its
// origin.
INLINED float found_emitter_density(const global view_t *view, const shown_t *shown, const float3 way)
{
    const float per_area = luminance(shown->appearance.emission) / view->light_power;
    const float3 normal = shown->surface.normal;
    const float radius = shown->surface.sphere_radius;
    if (HAS_SPHERES && radius > 0.0f) {
        const float3 outward = shown->surface.is_back ? -normal : normal;
        return sphere_share(view, per_area, radius) * sphere_lamp_density(radius, way, outward);
    }
    const float squared = dot_product(way, way);
    return emitter_density(view, per_area, squared, -dot_product(normal, way) / square_root(squared));
}

INLINED bool sample_emitter(
    const lights_t *lights, const global view_t *view, const float3 from, const uint choice, const uint more,
    const float2 sample, light_sample_t *found)
{
    const global light_t *light = lights->lights + choose(lights->light_choices, view->light_count, choice, more);
    if (HAS_SPHERES && light->radius > 0.0f) {
        const float3 radiance = load3(light->emission);
        const float density = sample_sphere_lamp(
            load3(light->a) - from, light->radius, sample, &found->direction, &found->distance);
        found->density = sphere_share(view, light->density, light->radius) * density;
        found->radiance = radiance / found->density;
        return density > 0.0f;
    }
    const float root = square_root(sample.x);
    const float3 point =
        load3(light->a) + (1.0f - root) * load3(light->ab) + root * sample.y * load3(light->ac);
    const float3 way = point - from;
    const float distance_squared = dot_product(way, way);
    if (!(distance_squared > 0.0f)) {
        return false;
    }
    found->distance = square_root(distance_squared);
    found->direction = way / found->distance;
    // It shines to both sides.
    const float cosine = absolute(dot_product(load3(light->normal), found->direction));
    if (!(cosine > 0.0f)) {
        return false;
    }
    found->density = emitter_density(view, light->density, distance_squared, cosine);
    found->radiance = load3(light->emission) / found->density;
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

// Draws a direction to light, by fixed-point numbers for the choice and for the bits that it takes, and by a point for
// the place on the light. Returns whether there is any.
INLINED bool sample_light(
    const lights_t *lights, const global view_t *view, const float3 from, const uint bits, const uint more,
    const float2 sample, light_sample_t *found)
{
    const int count = source_count(view);
    uint choice;
    int source = split_product(bits, count, &choice);
    if (count == 0) {
        return false;
    }
    if (view->has_sun) {
        if (source == 0) {
            found->direction = sample_sun(view, sample);
            found->radiance = PI * count * load3(view->light_colour);
            found->density = sun_density(view) / count;
            found->distance = INFINITY;
            return true;
        }
        source--;
    }
    if (view->light_count > 0 && source == 0) {
        return sample_emitter(lights, view, from, choice, more, sample, found);
    }
    return sample_environment(lights, view, sample, found);
}
