// A batch of rays of a scene in memory; see rays/batch.cl, whose arguments these kernels share.
//
// rays[ray_count]     scene_ray_t: local coordinates of the scene

#include "instances/instance.cl"
#include "rays/batch.cl"

// Loads the ray of this work-item. Returns its ray_id, or NO_RAY, with `ray` untouched, beyond the edges of the batch.
INLINED int load_scene_ray(
    const global scene_ray_t *rays, const int ray_count, const int row_length, const global int *order,
    scene_ray_pair_t *ray)
{
    const int ray_index = find_ray_index(ray_count, row_length);
    if (ray_index == NO_RAY) {
        return NO_RAY;
    }
    *ray = unpack_scene_ray(rays + ray_index);
    return order ? order[ray_index] : ray_index;
}
