// surface_at and point_above: the surface of triangle i at a crossing of a ray, and a ray from just above it.
//
// triangles[count]
// crossings[2 * count]                                       float: u, v
// directions[3 * count]                                      float: of the ray that crosses the triangle
// leaving[3 * count]                                         float: of the ray from above
// positions[3 * count], normals[3 * count], errors[3 * count]    written: of the surface
// points[3 * count]                                          written: above it
// is_hit[count]                                              written: whether the ray from there hits the triangle

#include "shading/surface.cl"
#include "triangles/single.cl"

kernel void find_surfaces(
    const global triangle_t *restrict triangles, const global float *restrict crossings,
    const global float *restrict directions, const global float *restrict leaving, global float *restrict positions,
    global float *restrict normals, global float *restrict errors, global float *restrict points,
    global int *restrict is_hit, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    crossing_t crossing = no_crossing();
    crossing.u = crossings[2 * i];
    crossing.v = crossings[2 * i + 1];
    const corners_t corners = corners_at(triangles, i);
    const surface_t surface = surface_at(&corners, &crossing, vload3(i, directions));
    vstore3(surface.position, i, positions);
    vstore3(surface.normal, i, normals);
    vstore3(surface.error, i, errors);
    vstore3(point_above(&surface), i, points);

    const ray_t ray = make_ray(point_above(&surface), vload3(i, leaving), 0.0f, INFINITY);
    search_t search = make_search(1, 0);
    intersect_triangle(triangles, i, &ray, &search, QUERY_COUNT);
    is_hit[i] = search.count;
}
