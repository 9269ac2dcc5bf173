// Rays in rows of the host's arrays, see `RayRows` of clbvh/trace/rays/batch.py.
//
// Parameters that the loops share:
//
// origins, directions         floats or doubles
// origin_step, direction_step from one ray's row to the next, in bytes; 0 if all rays share one
// doubles                     bit 0: origins are doubles, bit 1: directions are; else floats
// t_mins, t_maxs              limits of each ray, or one for all, in lengths of the direction
// each_limit                  bit 0: t_mins are of each ray, bit 1: t_maxs are

#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

typedef struct {
    const char *origins;
    const char *directions;
    long origin_step;
    long direction_step;
    int doubles;
    const double *t_mins;
    const double *t_maxs;
    int each_limit;
} ray_rows_t;

INLINED wide_ray_t read_ray(const ray_rows_t *rows, const long ray)
{
    const int size = 4;
    const wide_ray_t loaded = {
        load_vector(rows->origins + ray * rows->origin_step, rows->doubles & 1 ? 2 * size : size, rows->doubles & 1),
        load_vector(
            rows->directions + ray * rows->direction_step, rows->doubles & 2 ? 2 * size : size, rows->doubles & 2),
        rows->t_mins[rows->each_limit & 1 ? ray : 0], rows->t_maxs[rows->each_limit & 2 ? ray : 0]};
    return loaded;
}
