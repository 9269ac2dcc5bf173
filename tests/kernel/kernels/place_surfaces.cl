// place_surface: the surface of triangle i, as instance i places it, at a crossing of a ray; and a ray from just above.
//
// instances[count]                       instance_t
// triangles[count]                       in the geometry's local coordinates
// crossings[2 * count]                   float: u, v
// directions[3 * count]                  float: of the ray that crosses the triangle, in the scene
// leaving[3 * count]                     float: of the ray from above, in the scene
// points[3 * count], lows[3 * count]     written: the point above, as a pair
// normals[3 * count]                     written: in the scene
// is_hit[count]                          written: whether the ray from above hits the triangle

#include "instances/surface.cl"
#include "triangles/single.cl"

kernel void place_surfaces(
    const global instance_t *restrict instances, const global triangle_t *restrict triangles,
    const global float *restrict crossings, const global float *restrict directions,
    const global float *restrict leaving, global float *restrict points, global float *restrict lows,
    global float *restrict normals, global int *restrict is_hit, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    crossing_t crossing = no_crossing();
    crossing.u = crossings[2 * i];
    crossing.v = crossings[2 * i + 1];
    const corners_t corners = corners_at(triangles, i);
    const float3 direction = transform_vector(instances[i].to_object, vload3(i, directions));
    const surface_t surface = surface_at(&corners, &crossing, direction);
    const instance_surface_t placed = place_surface(instances + i, &surface);
    vstore3(placed.above, i, points);
    vstore3(placed.above_low, i, lows);
    vstore3(placed.normal, i, normals);

    const ray_pair_t ray = {
        placed.above, vload3(i, leaving), 0.0f, INFINITY, placed.above_low, (float3)(0.0f), 1};
    float t_shift;
    const ray_t inside = enter_instance(&ray, instances + i, INFINITY, &t_shift);
    search_t search = make_search(1, 0);
    intersect_triangle(triangles, i, &inside, &search, QUERY_COUNT);
    is_hit[i] = search.count;
}
