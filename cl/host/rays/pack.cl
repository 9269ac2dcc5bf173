// Rays, packed for a device, by clbvh/trace/rays/pack.py.

#define EXACT 1

#include "structs.cl"
#include "rays/pack.cl"
#include "rays/given.cl"

// Prefetch distance in rays, for rays in another order than their own. A million take 7 to 9 ms on two cores instead of
// 24; 16 and 40 perform alike.
#define PREFETCH_RAYS 40

#define ALL_GOOD -1
#define NOT_SHARED -2

static bool has_low(const double3 origin, const float low[3])
{
    const double3 high = (double3)((float)origin.x, (float)origin.y, (float)origin.z);
    const double3 rest = origin - high;
    return (float)rest.x == low[0] && (float)rest.y == low[1] && (float)rest.z == low[2];
}

// Writes rays; returns the number, from the first ray on, of the first bad one that is met, or ALL_GOOD; or NOT_SHARED,
// if float32 has rounded something else off an origin than `shared` says.
//
// order               rays to write, by their numbers; NULL for all in their own order
// lows, exact_lows    written: what float32 has rounded off, or all of a ray; NULL, or one of them
// shared              what it has rounded off the origins of all; or NULL
loop long write_packed(
    const ulong *rays, const long first_ray, const double box[7], const int *order, const long count,
    packed_ray_t packed[count], ray_low_t *lows, packed_exact_ray_t *exact_lows, const ray_low_t *shared)
{
    const given_rays_t given = rays_from(rays, first_ray);
    const tree_box_t tree_box = load_tree_box(box);
    for (long slot = 0; slot < count; slot++) {
        const long number = order ? order[slot] : slot;
        if (order) {
            will_read_given(&given, order[min(slot + PREFETCH_RAYS, count - 1)]);
        }
        wide_ray_t ray = read_ray(&given, number);
        const int way = localize_ray(&ray, &tree_box);
        if (way == BAD_RAY) {
            return number;
        }
        // The rays of a camera that is far away begin in different points.
        if (shared && (way == ADVANCED_RAY || !has_low(ray.origin, shared->origin))) {
            return NOT_SHARED;
        }
        store_vector(ray.origin, packed[slot].origin, lows ? lows[slot].origin : 0);
        store_vector(ray.direction, packed[slot].direction, lows ? lows[slot].direction : 0);
        packed[slot].t_min = (float)ray.t_min;
        packed[slot].t_max = (float)ray.t_max;
        if (lows) {
            lows[slot].mask = read_mask(&given, number);
        }
        if (exact_lows) {
            vstore3(ray.origin, 0, exact_lows[slot].origin);
            vstore3(ray.direction, 0, exact_lows[slot].direction);
            exact_lows[slot].mask = read_mask(&given, number);
        }
    }
    return ALL_GOOD;
}
