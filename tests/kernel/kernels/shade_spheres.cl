// sphere_surface_at and point_above: the surface of sphere i where ray i enters or leaves it, and a ray from there.
//
// rays[count], spheres[count]
// leaving[3 * count]                                             float: of the ray from above
// positions[3 * count], normals[3 * count], errors[3 * count]    written: of the surface
// points[3 * count]                                              written: above it
// sides[count]                                                   written: 0 where the ray enters, 1 where it leaves,
//                                                                -1 on a miss
// is_hit[count]                                                  written: whether the ray from there hits the sphere

#include "spheres/single.cl"
#include "spheres/surface.cl"

kernel void shade_spheres(
    const global packed_ray_t *restrict rays, const global sphere_t *restrict spheres,
    const global float *restrict leaving, global float *restrict positions, global float *restrict normals,
    global float *restrict errors, global float *restrict points, global int *restrict sides,
    global int *restrict is_hit, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const ray_t ray = unpack_ray(rays + i);
    search_t search = make_search(1, 0);
    intersect_sphere(spheres, i, &ray, &search, QUERY_CLOSEST);
    sides[i] = is_found(&search.nearest) ? (int)search.nearest.u : -1;
    if (!is_found(&search.nearest)) {
        return;
    }
    const ball_t ball = ball_at(spheres, i);
    const surface_t surface = sphere_surface_at(&ball, search.nearest.u > 0.0f, &ray);
    vstore3(surface.position, i, positions);
    vstore3(surface.normal, i, normals);
    vstore3(surface.error, i, errors);
    vstore3(point_above(&surface), i, points);

    const ray_t from_above = make_ray(point_above(&surface), vload3(i, leaving), 0.0f, INFINITY);
    search_t blockers = make_search(1, 0);
    intersect_sphere(spheres, i, &from_above, &blockers, QUERY_COUNT);
    is_hit[i] = blockers.count;
}
