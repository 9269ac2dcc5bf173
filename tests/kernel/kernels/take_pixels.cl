// film_direction and camera_ray: the ray of a pixel.
//
// pixels[count]                                 column and row
// views[1]                                      view_t; the camera is used
// directions[3 * count]                         written: film_direction
// origins[3 * count], ray_directions[3 * count] written: of the ray through the centre of the pixel

#include "rays/camera.cl"

kernel void take_pixels(
    const global int2 *restrict pixels, const global view_t *restrict views, global float *restrict directions,
    global float *restrict origins, global float *restrict ray_directions, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    vstore3(film_direction(views, pixel_centre(views, pixels[i].x, pixels[i].y)), i, directions);
    float3 origin, direction;
    camera_ray(views, pixel_centre(views, pixels[i].x, pixels[i].y), LENS_CENTRE, &origin, 0, &direction, 0);
    vstore3(origin, i, origins);
    vstore3(direction, i, ray_directions);
}
