// Computes hits on triangles again in double, see hits/refine.cl.
//
// Shared arguments, of which ray_count hits are refined: see cl/rays/arrays.cl.
// found[ray_count]             with a lone shape
// found_in_world[ray_count]    the same buffer, with any other world
// vertices, ..., is_lone       of the surfaces, see hits/surfaces.cl
// t[], u[], v[], is_front[], prim_id[], instance_id[], geometry_id[]    written, from the first ray's number, axes[0]
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "structs.cl"
#include "hits/refine.cl"
#include "hits/surfaces.cl"
#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

kernel void refine_hits(
    ARRAY_ARGUMENTS, const global hit_t *restrict found, const global world_hit_t *restrict found_in_world,
    const global char *restrict vertices, const int has_doubles, const global int *restrict faces,
    const global long *restrict first_vertex, const global long *restrict first_face,
    const global int *restrict geometry_ids, const global double *restrict linear,
    const global double *restrict offset, const global double *restrict world_scale,
    const global uchar *restrict is_mirrored, const int is_lone,
    global double *restrict t, global double *restrict u, global double *restrict v, global char *restrict is_front,
    global int *restrict prim_id, global int *restrict instance_id, global int *restrict geometry_id)
{
    const int index = get_global_id(0);
    if (index >= ray_count) {
        return;
    }
    const long target = axes[0] + index;
    const int prim = is_lone ? found[index].prim_id : found_in_world[index].prim_id;
    prim_id[target] = prim;
    if (prim == NO_PRIM) {
        t[target] = INFINITY;
        u[target] = v[target] = 0.0;
        is_front[target] = 0;
        instance_id[target] = geometry_id[target] = NO_PRIM;
        return;
    }
    const int instance = is_lone ? 0 : found_in_world[index].instance_id;
    const ray_arrays_t arrays = ARRAYS;
    const ray_place_t place = find_ray_place(&arrays, index);
    const wide_ray_t ray = load_wide_ray(&arrays, &place);
    surfaces_t surfaces;
    surfaces.vertices = vertices;
    surfaces.has_doubles = has_doubles;
    surfaces.faces = faces;
    surfaces.first_vertex = first_vertex;
    surfaces.first_face = first_face;
    surfaces.geometry_id = geometry_ids;
    surfaces.linear = linear;
    surfaces.offset = offset;
    surfaces.world_scale = world_scale;
    surfaces.is_mirrored = is_mirrored;
    surfaces.is_lone = is_lone;
    const refined_hit_t hit = refine_hit(&surfaces, &ray, instance, prim, false);
    t[target] = hit.t;
    u[target] = hit.u;
    v[target] = hit.v;
    is_front[target] = hit.side > 0.0;
    instance_id[target] = instance;
    geometry_id[target] = geometry_ids[instance];
}
