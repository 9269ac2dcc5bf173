// From a pixel to its ray.

#include "ray.cl"

// The ray through the centre of pixel (column, row); row 0 is the top. The direction has length 1, so t is a distance.
INLINED path_t primary_path(const global view_t *view, const int column, const int row)
{
    const float x = (2.0f * column + 1.0f) / view->width - 1.0f;
    const float y = 1.0f - (2.0f * row + 1.0f) / view->height;
    const float3 direction =
        load3(view->forward) + x * load3(view->right) + y * load3(view->up);
    return make_path(load3(view->eye), normalize(direction), 0.0f, INFINITY);
}
