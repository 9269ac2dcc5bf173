// Rays in arrays of the user, as the host's loops are told of them.
//
// Parameters that the loops share:
//
// rays                `RayBatch.addresses`
// first_ray           the number of the first ray; others are counted from it

#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// Rays from one on.
typedef struct {
    ray_arrays_t arrays;
    long first;
} given_rays_t;

INLINED given_rays_t rays_from(const ulong *rays, const long first)
{
    const given_rays_t given = {*(const ray_arrays_t *)rays, first};
    return given;
}

INLINED wide_ray_t read_ray(const given_rays_t *rays, const long ray)
{
    const ray_place_t place = find_ray_place(&rays->arrays, rays->first + ray);
    return load_wide_ray(&rays->arrays, &place);
}

INLINED uint read_mask(const given_rays_t *rays, const long ray)
{
    const ray_place_t place = find_ray_place(&rays->arrays, rays->first + ray);
    return load_mask(&rays->arrays, &place);
}

// Asks for a ray that is read later.
INLINED void will_read_given(const given_rays_t *rays, const long ray)
{
    const ray_place_t place = find_ray_place(&rays->arrays, rays->first + ray);
    will_read_ray(&rays->arrays, &place);
}
