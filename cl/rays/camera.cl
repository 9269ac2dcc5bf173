// The ray of a point of the picture, for a camera in `view_t`, see clbvh/structs.py.
//
// A point of the picture, `film`, has x to the right and y upwards, each from -1 to 1. Rays by the view's projection:
//
// perspective    from the eye along forward + x * right + y * up
// distorted      the same with the point of the plane at distance 1 that the lens shows at x and y; forward, right and
//                up are unit vectors
// orthographic   from eye + x * right + y * up along forward
// fisheye        from the eye, see rays/projections.cl; forward, right and up are unit vectors
// panorama       the same

#include "math/pairs.cl"
#include "math/vectors.cl"
#include "rays/projections.cl"
#include "sampling/warps.cl"

// The point of the lens for a picture without depth of field.
#define LENS_CENTRE ((float2)(0.5f))

// The centre of pixel (column, row); row 0 is the top.
INLINED float2 pixel_centre(const global view_t *view, const int column, const int row)
{
    return (float2)((2.0f * column + 1.0f) / view->width - 1.0f, 1.0f - (2.0f * row + 1.0f) / view->height);
}

// The direction through a point of the picture, not normalized.
INLINED float3 film_direction(const global view_t *view, const float2 film)
{
    return load3(view->forward) + film.x * load3(view->right) + film.y * load3(view->up);
}

// The same as a pair. What float32 rounds off the place in the picture is far below the size of a pixel, and has no
// pair.
INLINED float3 film_direction_pair(const global view_t *view, const float2 film, float3 *low)
{
    float3 sum_low;
    const float3 direction = add_exactly(
        load3(view->forward), film.x * load3(view->right) + film.y * load3(view->up), &sum_low);
    *low = load3(view->forward_low) + sum_low;
    return direction;
}

// A pair of the same direction and of length 1.
INLINED float3 unit_pair(const float3 direction, const float3 low, float3 *unit_low)
{
    const float scale = unit_scale(direction);
    const float3 scaled = scale * direction;
    const float to_unit = scale / square_root(dot_product(scaled, scaled));
    float3 product_low;
    const float3 unit = multiply_exactly(to_unit, direction, &product_low);
    *unit_low = product_low + to_unit * low;
    return unit;
}

// A fisheye and a panorama see far around, so that float32 is precise enough: the direction has no low part.
INLINED bool wide_direction(const global view_t *view, const float2 film, float3 *direction)
{
    float3 in_frame;
    bool is_seen = true;
    if (view->projection == PROJECTION_FISHEYE) {
        is_seen = fisheye_direction(view, film, &in_frame);
    } else {
        in_frame = panorama_direction(film);
    }
    *direction =
        unit_vector(in_frame.z * load3(view->forward) + in_frame.x * load3(view->right) + in_frame.y * load3(view->up));
    return is_seen;
}

// The ray through a point of the picture and a point of the lens, from 0 to 1 in both directions. Its direction has
// length 1. Both lows may be NULL, where float32 is enough. Returns whether the camera sees anything there; if not, the
// ray is one all the same.
INLINED bool camera_ray(
    const global view_t *view, const float2 film, const float2 lens, float3 *origin, float3 *origin_low,
    float3 *direction, float3 *direction_low)
{
    float3 start = load3(view->eye);
    float3 start_low = load3(view->eye_low);
    if (view->projection == PROJECTION_FISHEYE || view->projection == PROJECTION_PANORAMA) {
        *origin = start;
        if (direction_low) {
            *origin_low = start_low;
            *direction_low = (float3)(0.0f);
        }
        return wide_direction(view, film, direction);
    }

    // The direction before it is normalized: its depth along the optical axis is 1.
    float3 along, rest;
    float3 along_low = (float3)(0.0f);
    if (view->projection == PROJECTION_ORTHOGRAPHIC) {
        along = load3(view->forward);
        along_low = load3(view->forward_low);
        start = add_exactly(start, film.x * load3(view->right) + film.y * load3(view->up), &rest);
        start_low += rest;
    } else {
        const float2 point = view->projection == PROJECTION_DISTORTED ? undistorted_point(view, film) : film;
        if (direction_low) {
            along = film_direction_pair(view, point, &along_low);
        } else {
            along = film_direction(view, point);
        }
    }
    // Rays from all of the lens meet in the plane of focus, where `along` reaches depth 1 at t = 1.
    if (view->has_lens) {
        const float2 on_lens = sample_disk(lens);
        const float3 offset = on_lens.x * load3(view->lens_right) + on_lens.y * load3(view->lens_up);
        start = add_exactly(start, offset, &rest);
        start_low += rest;
        along = add_exactly(along, -view->inverse_focus * offset, &rest);
        along_low += rest;
    }

    *origin = start;
    if (direction_low) {
        *origin_low = start_low;
        *direction = unit_pair(along, along_low, direction_low);
    } else {
        *direction = unit_vector(along);
    }
    return true;
}
