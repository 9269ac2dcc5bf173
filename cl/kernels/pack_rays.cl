// Packs rays that are in arrays on the device, to the bits of clbvh/trace/rays/pack.py, which tells why.
//
// Shared arguments: see cl/rays/arrays.cl.
// box[7]              of the world: the centre, half the size along each axis, and the scale, see `TreeBox`
// masks[]             of each ray if mask_step is 1, or one for all if it is 0
// rays[ray_count]     written: the world's local coordinates
// lows[ray_count]     written: what float32 has rounded off; NULL with a lone shape
// bad                 lowered to the number of a ray that is not finite, has no direction, or is too far
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "structs.cl"
#include "rays/arrays.cl"
#include "exact/ray.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// The numbers of clbvh/trace/rays/pack.py, which has their reasons.
#define MOST_FAST_EXPONENT 400
#define NEAR_SHARE 8.0
#define BOX_SLACK 0x1p-20
#define DISTANCE_SLACK 0x1p-48
#define STEP_SHARE 0.25
#define WHOLE_STEPS 0x1p60
#define MOST_ADVANCES 32

// Stores a vector in float32, and if asked what that has rounded off.
INLINED void store_vector(const double3 v, global float *high, global float *low)
{
    const double numbers[3] = {v.x, v.y, v.z};
    for (int axis = 0; axis < 3; axis++) {
        high[axis] = (float)numbers[axis];
        if (low) {
            low[axis] = (float)(numbers[axis] - (double)(float)numbers[axis]);
        }
    }
}

// Narrows an interval of a ray, its begin and its end, to the part between -half and half on one axis.
INLINED double2 clip(const double origin, const double direction, const double half_size, const double2 t)
{
    if (direction == 0.0) {
        return fabs(origin) <= half_size ? t : (double2)(INFINITY, -INFINITY);
    }
    const double inverse = 1.0 / direction;
    const double middle = -origin * inverse, width = half_size * fabs(inverse);
    return (double2)(most_of(t.x, middle - width), least_of(t.y, middle + width));
}

INLINED bool is_near(const double3 origin, const double reach)
{
    return fabs(origin.x) <= reach && fabs(origin.y) <= reach && fabs(origin.z) <= reach;
}

// Moves an origin close to the box; a ray that misses that gets an empty interval.
INLINED wide_ray_t advance_ray(wide_ray_t ray, const double3 half_size, const double size)
{
    const double step = times_power_of_two(STEP_SHARE, exponent_of(size));
    for (int count = 0; count < MOST_ADVANCES; count++) {
        if (is_near(ray.origin, NEAR_SHARE * size)) {
            return ray;
        }
        const double slack = BOX_SLACK * size +
            (DISTANCE_SLACK * fabs(ray.origin.x) + DISTANCE_SLACK * fabs(ray.origin.y) +
             DISTANCE_SLACK * fabs(ray.origin.z));
        double2 t = (double2)(0.0, ray.t_max);
        t = clip(ray.origin.x, ray.direction.x, half_size.x + slack, t);
        t = clip(ray.origin.y, ray.direction.y, half_size.y + slack, t);
        t = clip(ray.origin.z, ray.direction.z, half_size.z + slack, t);
        if (!(t.x <= t.y && t.y >= ray.t_min)) {
            break;
        }
        const double advance = t.x < WHOLE_STEPS ? floor(t.x / step) * step : t.x;
        ray.origin = ray.origin + advance * ray.direction;
        ray.t_min = most_of(ray.t_min - advance, 0.0);
        ray.t_max = ray.t_max - advance;
    }
    ray.origin = (double3)(0.0);
    ray.t_min = 0.0;
    ray.t_max = -1.0;
    return ray;
}

kernel void pack_rays(
    ARRAY_ARGUMENTS, const global double *restrict box, const global uint *restrict masks, const int mask_step,
    global packed_ray_t *restrict rays, global ray_rest_t *restrict lows, global int *restrict bad)
{
    const int index = get_global_id(0);
    if (index >= ray_count) {
        return;
    }
    wide_ray_t ray = load_wide_ray(
        origins, directions, doubles, axes, axis_count, t_mins, t_maxs, each_limit, index);
    const double3 half_size = (double3)(box[3], box[4], box[5]);
    const double size = most_of(most_of(half_size.x, half_size.y), half_size.z), scale = box[6];
    ray.origin = (ray.origin - (double3)(box[0], box[1], box[2])) * scale;

    // Infinity minus infinity is NaN, and so is anything with NaN.
    const double3 d = ray.direction, nothing = (d - d) + (ray.origin - ray.origin);
    const double longest = largest_size(d);
    if (!(nothing.x + nothing.y + nothing.z == 0.0 && longest > 0.0)) {
        atomic_min(bad, index);
        return;
    }
    const int exponent = exponent_of(longest);
    ray.direction = times_power_of_two3(d, -exponent);
    if (abs(exponent) <= MOST_FAST_EXPONENT && is_near(ray.origin, NEAR_SHARE * size)) {
        const double stretch = power_of_two(exponent) * scale;
        ray.t_min *= stretch;
        ray.t_max *= stretch;
    } else {
        const int stretch = exponent + exponent_of(scale);
        ray.t_min = times_power_of_two(ray.t_min, stretch);
        ray.t_max = times_power_of_two(ray.t_max, stretch);
        ray = advance_ray(ray, half_size, size);
    }
    global packed_ray_t *packed = rays + index;
    global ray_rest_t *low = lows ? lows + index : 0;
#if EXACT
    store_vector(ray.origin, packed->origin, 0);
    store_vector(ray.direction, packed->direction, 0);
    vstore3(ray.origin, 0, low->origin);
    vstore3(ray.direction, 0, low->direction);
#else
    store_vector(ray.origin, packed->origin, low ? low->origin : 0);
    store_vector(ray.direction, packed->direction, low ? low->direction : 0);
#endif
    packed->t_min = (float)ray.t_min;
    packed->t_max = (float)ray.t_max;
    if (low) {
        low->mask = masks[mask_step * index];
    }
}
