// Bounds of the rays that a camera sends through a rectangle of its picture.

#include "boxes/beam.cl"
#include "structs.cl"

// Roundings of a ray's direction, relative to |forward| + reach * (|right| + |up|), with the farthest x or y of the
// rectangle as reach. At most 22 for a ray: twice 5 by the division in x or y, which is up to 2, twice 4 by the place
// in the pixel and the difference there, and 4 by a product and two sums. A corner has as many; the lens adds 4, the
// normalization 5, and the slack itself 3.
#define DIRECTION_SLACK ERROR_BOUND(22 + 22 + 4 + 5 + 3)

// Roundings of an origin: products and sums of the point in the picture and of that on the lens, and the slack's own.
#define ORIGIN_SLACK ERROR_BOUND(22 + 22 + 4 + 3)

// The bounds of all rays through the rectangle from `lower` to `upper`, two points of the picture, and through any
// point of the lens. Directions are as long as before their normalization: t has no limit. Returns whether there are
// bounds: only for projections in which straight lines of the picture are planes of rays.
INLINED bool bound_camera_rays(
    const global view_t *view, const float2 lower, const float2 upper, ray_bounds_t *bounds)
{
    const bool is_parallel = view->projection == PROJECTION_ORTHOGRAPHIC;
    if (view->projection != PROJECTION_PERSPECTIVE && !is_parallel) {
        return false;
    }
    const float3 eye = load3(view->eye);
    const float3 forward = load3(view->forward);
    float3 lower_direction = (float3)(INFINITY);
    float3 upper_direction = (float3)(-INFINITY);
    float3 lower_origin = lower_direction;
    float3 upper_origin = upper_direction;
    for (int corner = 0; corner < 4; corner++) {
        const float2 film = (float2)(corner & 1 ? lower.x : upper.x, corner & 2 ? lower.y : upper.y);
        const float3 place = film.x * load3(view->right) + film.y * load3(view->up);
        const float3 origin = is_parallel ? eye + place : eye;
        const float3 direction = is_parallel ? forward : forward + place;
        lower_origin = origin < lower_origin ? origin : lower_origin;
        upper_origin = origin > upper_origin ? origin : upper_origin;
        lower_direction = direction < lower_direction ? direction : lower_direction;
        upper_direction = direction > upper_direction ? direction : upper_direction;
    }
    const float reach = larger(larger(-lower.x, upper.x), larger(larger(-lower.y, upper.y), 1.0f));
    const float3 picture = reach * (magnitude(load3(view->right)) + magnitude(load3(view->up)));
    const float3 lens = magnitude(load3(view->lens_right)) + magnitude(load3(view->lens_up));
    const float3 turn = view->inverse_focus * lens;
    const float3 aside = turn + (magnitude(forward) + picture + turn) * DIRECTION_SLACK;
    // Without a lens and with perspective, the origin is exact.
    const bool is_exact = !is_parallel && !view->has_lens;
    const float3 around = is_exact ? (float3)(0.0f) : lens + (magnitude(eye) + picture + lens) * ORIGIN_SLACK;
    bounds->lower = (float8)(lower_origin - around, 0.0f, lower_direction - aside, INFINITY);
    bounds->upper = (float8)(upper_origin + around, 0.0f, upper_direction + aside, INFINITY);
    return true;
}
