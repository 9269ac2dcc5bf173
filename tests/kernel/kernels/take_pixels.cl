// film_direction and primary_ray: the ray of a pixel.
//
// pixels[count]                                 column and row
// views[1]                                      view_t; the camera is used
// directions[3 * count]                         written: film_direction
// origins[3 * count], ray_directions[3 * count] written: of the primary ray
// limits[count]                                 written: t_min, t_max of the primary ray

#include "rays/camera.cl"

kernel void take_pixels(
    const global int2 *restrict pixels, const global view_t *restrict views, global float *restrict directions,
    global float *restrict origins, global float *restrict ray_directions, global float2 *restrict limits,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    vstore3(film_direction(views, pixel_centre(views, pixels[i].x, pixels[i].y)), i, directions);
    const ray_t ray = primary_ray(views, pixels[i].x, pixels[i].y);
    vstore3(ray.origin, i, origins);
    vstore3(ray.direction, i, ray_directions);
    limits[i] = (float2)(ray.t_min, ray.t_max);
}
