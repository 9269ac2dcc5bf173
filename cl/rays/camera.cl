// From a pixel to its ray.

#include "ray.cl"

// Through the centre of pixel (column, row); row 0 is the top.
INLINED float3 through_pixel(const global view_t *view, const int column, const int row)
{
    const float x = (2.0f * column + 1.0f) / view->width - 1.0f;
    const float y = 1.0f - (2.0f * row + 1.0f) / view->height;
    return load3(view->forward) + x * load3(view->right) + y * load3(view->up);
}

// The direction has length 1, so t is a distance.
INLINED path_t primary_path(const global view_t *view, const int column, const int row)
{
    return make_path(load3(view->eye), normalize(through_pixel(view, column, row)), 0.0f, INFINITY);
}
