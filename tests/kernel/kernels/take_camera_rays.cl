// camera_ray: the ray of a point of the picture and a point of the lens, as pairs and in float32.
//
// films[2 * count]                    points of the picture
// lenses[2 * count]                   points of the lens
// views[1]                            view_t; the camera is used
// origins, origin_lows, directions, direction_lows[3 * count]    written: the pairs
// single_origins, single_directions[3 * count]                   written: without low parts
// seen[count]                         written: what camera_ray returns

#include "rays/camera.cl"

kernel void take_camera_rays(
    const global float2 *restrict films, const global float2 *restrict lenses, const global view_t *restrict views,
    global float *restrict origins, global float *restrict origin_lows, global float *restrict directions,
    global float *restrict direction_lows, global float *restrict single_origins,
    global float *restrict single_directions, global int *restrict seen, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    float3 origin, origin_low, direction, direction_low;
    seen[i] = camera_ray(views, films[i], lenses[i], &origin, &origin_low, &direction, &direction_low);
    vstore3(origin, i, origins);
    vstore3(origin_low, i, origin_lows);
    vstore3(direction, i, directions);
    vstore3(direction_low, i, direction_lows);
    camera_ray(views, films[i], lenses[i], &origin, 0, &direction, 0);
    vstore3(origin, i, single_origins);
    vstore3(direction, i, single_directions);
}
