// Rays in arrays of the user, read where they are: of floats or doubles, with any strides, broadcast to their shape.
//
// Arguments that the kernels share:
//
// origins, directions     buffers, as bytes
// t_mins, t_maxs          doubles, as bytes: limits in lengths of the direction
// masks                   uints, as bytes
// doubles                 bit 0: origins are doubles, bit 1: directions are; else floats
// axes[2 + axis_count]    long[6], the columns for the rays and for each array in this order:
//                           first row            the number of the first ray; the bytes before the items
//                           second row           3; the bytes from one coordinate to the next
//                           each leading axis    its length; the bytes from one item to the next, 0 where it is
//                                                broadcast
// axis_count              leading axes, at least 1
// ray_count               rays from the first one on

// keep: doubles
#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define ARRAY_ARGUMENTS \
    const global char *restrict origins, const global char *restrict directions, const global char *restrict t_mins, \
    const global char *restrict t_maxs, const global char *restrict masks, const int doubles, \
    const global long *restrict axes, const int axis_count, const int ray_count

// The initializer of a ray_arrays_t from these arguments.
#define ARRAYS {origins, directions, t_mins, t_maxs, masks, doubles, axes, axis_count}

typedef struct {
    const global char *origins;
    const global char *directions;
    const global char *t_mins;
    const global char *t_maxs;
    const global char *masks;
    int doubles;
    const global long *axes;
    int axis_count;
} ray_arrays_t;

// The columns of `axes`.
#define RAYS_COLUMN 0
#define ORIGINS_COLUMN 1
#define DIRECTIONS_COLUMN 2
#define T_MINS_COLUMN 3
#define T_MAXS_COLUMN 4
#define MASKS_COLUMN 5
#define COLUMNS 6

// A ray in double.
typedef struct {
    double3 origin;
    double3 direction;
    double t_min;
    double t_max;
} wide_ray_t;

// The bytes before each array's item, by columns.
typedef struct {
    long at[COLUMNS];
} ray_place_t;

INLINED ray_place_t find_ray_place(const ray_arrays_t *arrays, const long ray)
{
    const global long *axes = arrays->axes;
    ray_place_t place;
    long left = axes[RAYS_COLUMN] + ray;
    for (int column = ORIGINS_COLUMN; column < COLUMNS; column++) {
        place.at[column] = axes[column];
    }
    for (int axis = arrays->axis_count + 1; axis >= 2; axis--) {
        const global long *steps = axes + COLUMNS * axis;
        long index = left;
        if (axis > 2) {
            index = left % steps[RAYS_COLUMN];
            left /= steps[RAYS_COLUMN];
        }
        for (int column = ORIGINS_COLUMN; column < COLUMNS; column++) {
            place.at[column] += index * steps[column];
        }
    }
    return place;
}

INLINED double load_number(const global char *from, const int is_double)
{
    return is_double ? *(const global double *)from : (double)*(const global float *)from;
}

INLINED double3 load_vector(const global char *from, const long step, const int is_double)
{
    return (double3)(
        load_number(from, is_double), load_number(from + step, is_double), load_number(from + 2 * step, is_double));
}

INLINED double3 load_origin(const ray_arrays_t *arrays, const ray_place_t *place)
{
    return load_vector(
        arrays->origins + place->at[ORIGINS_COLUMN], arrays->axes[COLUMNS + ORIGINS_COLUMN], arrays->doubles & 1);
}

INLINED wide_ray_t load_wide_ray(const ray_arrays_t *arrays, const ray_place_t *place)
{
    const global long *coordinates = arrays->axes + COLUMNS;
    const wide_ray_t loaded = {
        load_origin(arrays, place),
        load_vector(
            arrays->directions + place->at[DIRECTIONS_COLUMN], coordinates[DIRECTIONS_COLUMN], arrays->doubles & 2),
        *(const global double *)(arrays->t_mins + place->at[T_MINS_COLUMN]),
        *(const global double *)(arrays->t_maxs + place->at[T_MAXS_COLUMN])};
    return loaded;
}

INLINED uint load_mask(const ray_arrays_t *arrays, const ray_place_t *place)
{
    return *(const global uint *)(arrays->masks + place->at[MASKS_COLUMN]);
}

// Asks for a ray's vectors before they are loaded: for both ends of each, which may cross a cache line.
INLINED void will_read_ray(const ray_arrays_t *arrays, const ray_place_t *place)
{
    const global long *coordinates = arrays->axes + COLUMNS;
    for (int column = ORIGINS_COLUMN; column <= DIRECTIONS_COLUMN; column++) {
        const global char *from = (column == ORIGINS_COLUMN ? arrays->origins : arrays->directions) + place->at[column];
        WILL_READ(from);
        WILL_READ(from + 2 * coordinates[column]);
    }
}
