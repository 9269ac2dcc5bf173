// A batch of rays of a scene in memory; see rays/batch.cl, whose arguments these kernels share.
//
// rays[ray_count]                   packed_ray_t: local coordinates of the scene
// lows[1 or ray_count], low_step    scene_low_t: of all rays, or one for each; 0 or 1

#include "instances/instance.cl"
#include "rays/batch.cl"

// Loads the ray of this work-item. Returns its ray_id, or NO_RAY, with `ray` untouched, beyond the edges of the batch.
INLINED int load_scene_ray(
    const global packed_ray_t *rays, const global scene_low_t *lows, const int low_step, const int ray_count,
    const int row_length, const global int *order, scene_ray_pair_t *ray)
{
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return NO_RAY;
    }
    *ray = unpack_scene_ray(rays + ray_index, lows + low_step * ray_index);
    return find_ray_id(ray_index, order);
}
