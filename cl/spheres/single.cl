// Single spheres, in the layouts whose blocks are one primitive.

#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#include "spheres/distance.cl"
#include "spheres/sphere.cl"

typedef sphere_t sphere_block_t;

INLINED ball_t ball_at(const global sphere_block_t *spheres, const int sphere_index)
{
    const ball_t ball = {load3(spheres[sphere_index].centre), spheres[sphere_index].radius};
    return ball;
}

INLINED void intersect_sphere(
    const global sphere_block_t *spheres, const int sphere_index, const ray_t *ray, search_t *search, const int query)
{
    const global sphere_block_t *sphere = spheres + sphere_index;
    intersect_sheared_origin(
        shear_origin(load3(sphere->centre), ray), sphere->radius, sphere->prim_id, sphere_index, ray, search, query);
}

INLINED void test_sphere(nearest_t *nearest, const global sphere_block_t *sphere)
{
    const point_t centre = {sphere->centre[0], sphere->centre[1], sphere->centre[2]};
    add_distance(nearest, distance_squared_to_sphere(nearest, centre, sphere->radius), INFINITY, sphere->prim_id);
}
