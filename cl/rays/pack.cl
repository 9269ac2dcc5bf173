// Rays as the device takes them: in the world's local coordinates, in float32; see clbvh/trace/rays/pack.py.
//
// A ray that starts far from a small mesh would lose the mesh in the rounding of its origin. So a distant origin is
// first advanced along the ray to just before the box. A ray that misses the box is given an empty interval, which ends
// its traversal at once.

#include "structs.cl"
#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// The powers of two with exponents up to this, times the scale of any mesh, are normal numbers.
#define MOST_FAST_EXPONENT 400

// An origin within NEAR_SHARE times half the box's size is not advanced: float32 rounds by 2^-21 of that there, and a
// ray takes 9 ns instead of 17 on a 2-core x86-64 server.

// The box is grown by these shares of its size and of the origin's distance before a ray is said to miss it: far more
// than float64 rounds, and nothing to the device.
#define BOX_SLACK 0x1p-20
#define DISTANCE_SLACK 0x1p-48

// An origin is advanced by a whole number of steps: this share of the box's size, rounded down to a power of two. So a
// point on a grid stays on it, and a ray exactly through a vertex still meets it exactly.
#define STEP_SHARE 0.25
#define WHOLE_STEPS 0x1p60

// An advance leaves 2^-53 of an origin's distance, so that float64's farthest origin comes near in 20.
#define MOST_ADVANCES 32

// The box of a world, see `TreeBox`.
typedef struct {
    double3 centre;     // the file's coordinates
    double3 half_size;  // local coordinates
    double scale;
} tree_box_t;

INLINED tree_box_t load_tree_box(const global double *box)
{
    const tree_box_t loaded = {
        (double3)(box[0], box[1], box[2]), (double3)(box[3], box[4], box[5]), box[6]};
    return loaded;
}

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

#define BAD_RAY 0
#define NEAR_RAY 1
#define ADVANCED_RAY 2

// Brings a ray from the file's coordinates to the world's, with a longest component of its direction from 1 to 2, and
// close to the box. Returns BAD_RAY if it is not finite, has no direction, or is too far.
INLINED int localize_ray(wide_ray_t *ray, const tree_box_t *box)
{
    const double size = most_of(most_of(box->half_size.x, box->half_size.y), box->half_size.z);
    ray->origin = (ray->origin - box->centre) * box->scale;

    // Infinity minus infinity is NaN, and so is anything with NaN.
    const double3 d = ray->direction;
    const double3 nothing = (d - d) + (ray->origin - ray->origin);
    const double longest = largest_size(d);
    if (!(nothing.x + nothing.y + nothing.z == 0.0 && longest > 0.0)) {
        return BAD_RAY;
    }
    const int exponent = exponent_of(longest);
    if (abs(exponent) <= MOST_FAST_EXPONENT && is_near(ray->origin, NEAR_SHARE * size)) {
        const double stretch = power_of_two(exponent) * box->scale;
        ray->direction = d * power_of_two(-exponent);
        ray->t_min *= stretch;
        ray->t_max *= stretch;
        return NEAR_RAY;
    }
    const int stretch = exponent + exponent_of(box->scale);
    ray->direction = times_power_of_two3(d, -exponent);
    ray->t_min = times_power_of_two(ray->t_min, stretch);
    ray->t_max = times_power_of_two(ray->t_max, stretch);
    *ray = advance_ray(*ray, box->half_size, size);
    return ADVANCED_RAY;
}
