// The ray of a pixel, for a camera in `view_t`, see clbvh/structs.py.

#include "math/vectors.cl"
#include "rays/ray.cl"

// The centre of pixel (column, row) in the picture's plane, from -1 to 1; row 0 is the top.
INLINED float2 pixel_centre(const global view_t *view, const int column, const int row)
{
    return (float2)((2.0f * column + 1.0f) / view->width - 1.0f, 1.0f - (2.0f * row + 1.0f) / view->height);
}

// The direction through the centre of a pixel, not normalized.
INLINED float3 pixel_direction(const global view_t *view, const int column, const int row)
{
    const float2 centre = pixel_centre(view, column, row);
    return load3(view->forward) + centre.x * load3(view->right) + centre.y * load3(view->up);
}

// The direction has length 1, so t is a distance in local units.
INLINED ray_t primary_ray(const global view_t *view, const int column, const int row)
{
    return make_ray(load3(view->eye), unit_vector(pixel_direction(view, column, row)), 0.0f, INFINITY);
}
