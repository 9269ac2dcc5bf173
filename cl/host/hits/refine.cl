// Refines the closest hits of rays, for clbvh/trace/hits/refine.py.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/refined.cl"
#include "hits/surfaces.cl"
#include "rays/arrays.cl"
#include "rays/given.cl"

// How many hits ahead corners are asked for, and faces.
#define CORNERS_AHEAD 12
#define PRIMS_AHEAD 24

// Writes one hit for each ray; see hits/refine.cl.
//
// arrays              `SurfaceArrays.addresses`
// rays, first_ray     see cl/rays/given.cl
// found, found_in_world    one of both
// t[], ..., instance_id[]  written; the last of worlds with instances alone
loop void refine_closest(
    const ulong *arrays, const ulong *rays, const long first_ray, const hit_t *found, const world_hit_t *found_in_world,
    const long count, double *t, double *u, double *v, bool *is_front, int *prim_id, int *instance_id)
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    const given_rays_t given = rays_from(rays, first_ray);
    const found_hits_t hits = {found, found_in_world};
    const refined_hits_t refined = {t, u, v, (uchar *)is_front, prim_id, found_in_world ? instance_id : 0};
    for (long index = 0; index < count; index++) {
        if (index + PRIMS_AHEAD < count) {
            will_read_prim(&surfaces, &hits, index + PRIMS_AHEAD);
        }
        if (index + CORNERS_AHEAD < count) {
            will_read_corners(&surfaces, &hits, index + CORNERS_AHEAD);
        }
        if (prim_of(&hits, index) == NO_PRIM) {
            write_miss(&refined, index);
        } else {
            const wide_ray_t ray = read_ray(&given, index);
            refine_found(&surfaces, &ray, &hits, index, &refined, index);
        }
    }
}
