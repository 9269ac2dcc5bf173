// Single spheres, in the layouts whose blocks are one primitive.

#include "spheres/sphere.cl"

INLINED void intersect_sphere(
    const global sphere_t *spheres, const int sphere_index, const ray_t *ray, search_t *search, const int query)
{
    const global sphere_t *sphere = spheres + sphere_index;
    intersect_sheared_origin(
        shear_origin(load3(sphere->centre), ray), sphere->radius, sphere->prim_id, sphere_index, ray, search, query);
}
