// The ground of a picture: a plane that shows nothing but shadows, which fade out towards its radius.

#include "structs.cl"
#include "math/vectors.cl"
#include "shading/shade.cl"
#include "world/surface.cl"

// The share of the radius within which shadows are shown in full.
#define GROUND_CORE 0.5f

// The ambient light is stronger than in the shading `lambert`, because nearby surfaces keep off much of it.
#define AMBIENT_FACTOR 1.6f

// The light from the sky or from the ground along a direction.
INLINED float3 find_ambient_light(const global view_t *view, const float3 direction)
{
    const float up = 0.5f + 0.5f * dot_product(direction, load3(view->to_sky));
    return AMBIENT_FACTOR * blend(load3(view->ground_colour), load3(view->sky_colour), up);
}

typedef struct {
    position_t above;
    float distance_squared;  // from the middle of the ground
    bool is_met;
} ground_t;

// The ground where a ray meets it from above, with is_met false where it does not.
INLINED ground_t find_ground(const global view_t *view, const world_ray_t *ray)
{
    ground_t ground;
    ground.above.high = (float3)(0.0f);
    ground.above.low = (float3)(0.0f);
    ground.distance_squared = 0.0f;
    ground.is_met = false;
    if (!(view->ground_radius > 0.0f)) {
        return ground;
    }
    const float3 normal = load3(view->ground_normal);
    const float3 centre = load3(view->ground_point);
    const float height = dot_product(ray->origin - centre, normal);
    const float sinking = -dot_product(ray->direction, normal);
    if (!(height > 0.0f && sinking > 0.0f)) {
        return ground;
    }
    const float3 at = ray->origin + height / sinking * ray->direction;
    const float3 from_centre = at - centre;
    ground.distance_squared = dot_product(from_centre, from_centre);
    ground.is_met = ground.distance_squared < view->ground_radius * view->ground_radius;
    ground.above.high = at;
    return ground;
}

// The strength of a shadow on the ground, from 0 to 1, which paths take for the ground's share of the light.
INLINED float find_shadow_strength(const global view_t *view, const ground_t *ground)
{
    const float share = square_root(ground->distance_squared) / view->ground_radius;
    const float fading = limit_share((1.0f - share) / (1.0f - GROUND_CORE));
    // Smooth at both ends (the cubic Hermite polynomial).
    return fading * fading * (3.0f - 2.0f * fading);
}

// The sample of a ray that meets nothing but the background, under a shadow from 0 to 1. A transparent background has
// no light of its own, and the shadow covers what will be behind it.
INLINED float4 sample_of_background(const global view_t *view, const int row, const float shadow)
{
    if (view->is_transparent) {
        return (float4)((float3)(0.0f), shadow);
    }
    return (float4)((1.0f - shadow) * find_background(view, row), 0.0f);
}
