// Hits on the host that are computed again in double, and where they go; see hits/refine.cl.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/refine.cl"
#include "hits/surfaces.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// The arrays of `RefinedHits`.
typedef struct {
    double *t;
    double *u;
    double *v;
    uchar *is_front;
    int *prim_id;
    int *instance_id;  // NULL with a lone shape
} refined_hits_t;

// Asks for the places of a hit before it is written.
INLINED void will_write_hit(const refined_hits_t *hits, const long index)
{
    WILL_WRITE(hits->t + index);
    WILL_WRITE(hits->u + index);
    WILL_WRITE(hits->v + index);
    WILL_WRITE(hits->is_front + index);
    WILL_WRITE(hits->prim_id + index);
}

INLINED void write_hit(
    const refined_hits_t *hits, const long index, const refined_hit_t hit, const int prim, const int instance)
{
    hits->t[index] = hit.t;
    hits->u[index] = hit.u;
    hits->v[index] = hit.v;
    hits->is_front[index] = hit.side > 0.0;
    hits->prim_id[index] = prim;
    if (hits->instance_id) {
        hits->instance_id[index] = instance;
    }
}

INLINED void write_miss(const refined_hits_t *hits, const long index)
{
    const refined_hit_t miss = {INFINITY, 0.0, 0.0, 0.0};
    write_hit(hits, index, miss, NO_PRIM, NO_PRIM);
}

// Refines a hit that was found, and writes it.
INLINED void refine_found(
    const surfaces_t *surfaces, const wide_ray_t *ray, const found_hits_t *found, const long source,
    const refined_hits_t *hits, const long index)
{
    const int prim = prim_of(found, source), instance = instance_of(found, source);
    write_hit(hits, index, refine_hit(surfaces, ray, instance, prim, is_leaving(found, source)), prim, instance);
}
