// Rays in arrays of the user, read where they are: of floats or doubles, with any strides, broadcast to their shape.
//
// Arguments that the kernels share:
//
// origins, directions     buffers, as bytes
// doubles                 bit 0: origins are doubles, bit 1: directions are; else floats
// axes[2 + axis_count]    long[3], for the rays, the origins and the directions: the number of the first ray, and the
//                         bytes before the arrays; 3, and the bytes from one coordinate to the next; and of each
//                         leading axis its length, and the bytes from one item to the next, 0 where it is broadcast
// t_mins[], t_maxs[]      limits of each ray, or one for all, in lengths of the direction
// each_limit              bit 0: t_mins are of each ray, bit 1: t_maxs are

// keep: doubles
#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define ARRAY_ARGUMENTS \
    const global char *restrict origins, const global char *restrict directions, const int doubles, \
    const global long *restrict axes, const int axis_count, const global double *restrict t_mins, \
    const global double *restrict t_maxs, const int each_limit, const int ray_count

typedef struct {
    double3 origin;
    double3 direction;
    double t_min;
    double t_max;
} wide_ray_t;

INLINED double load_number(const global char *from, const int is_double)
{
    return is_double ? *(const global double *)from : (double)*(const global float *)from;
}

INLINED double3 load_vector(const global char *from, const long step, const int is_double)
{
    return (double3)(
        load_number(from, is_double), load_number(from + step, is_double), load_number(from + 2 * step, is_double));
}

INLINED wide_ray_t load_wide_ray(
    const global char *origins, const global char *directions, const int doubles, const global long *axes,
    const int axis_count, const global double *t_mins, const global double *t_maxs, const int each_limit, const int ray)
{
    long left = axes[0] + ray, origin_at = axes[1], direction_at = axes[2];
    for (int axis = axis_count + 1; axis > 1; axis--) {
        const long length = axes[3 * axis], index = left % length;
        left /= length;
        origin_at += index * axes[3 * axis + 1];
        direction_at += index * axes[3 * axis + 2];
    }
    const wide_ray_t loaded = {
        load_vector(origins + origin_at, axes[4], doubles & 1),
        load_vector(directions + direction_at, axes[5], doubles & 2),
        t_mins[each_limit & 1 ? ray : 0], t_maxs[each_limit & 2 ? ray : 0]};
    return loaded;
}
