// bound_camera_rays: the bounds of the rays through a rectangle of the picture.
//
// rectangles[4 * count]      lower x, lower y, upper x, upper y
// views[1]                   view_t; the camera is used
// lower, upper[8 * count]    written: ray_bounds_t
// bounded[count]             written: what bound_camera_rays returns

// keep: boxes/beam.cl takes the layout from here.
#include "traversal/traverse.cl"

#include "rays/camera_bounds.cl"

kernel void bound_camera(
    const global float4 *restrict rectangles, const global view_t *restrict views, global float8 *restrict lower,
    global float8 *restrict upper, global int *restrict bounded, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    ray_bounds_t bounds = empty_bounds();
    bounded[i] = bound_camera_rays(views, rectangles[i].lo, rectangles[i].hi, &bounds);
    lower[i] = bounds.lower;
    upper[i] = bounds.upper;
}
