// Rays of the camera at a world of which a part is cut away: the far side of a plane, or the inside of a box.
//
// HAS_CUT, if defined as 1: the picture may have a cut, and its kind tells; clbvh/views/cut.py has the same
// formulas.

#include "structs.cl"
#include "math/vectors.cl"
#include "world/world.cl"

#if HAS_CUT

// The part of a ray that is cut away, from `begin` to `end`; none if `end` is less.
typedef struct {
    float begin;
    float end;
} cut_range_t;

// The part of a ray between two planes at right angles to an axis.
INLINED cut_range_t find_slab_range(const float origin, const float direction, const float lower, const float upper)
{
    if (direction == 0.0f) {
        const bool is_inside = lower <= origin && origin <= upper;
        return (cut_range_t){is_inside ? -INFINITY : INFINITY, is_inside ? INFINITY : -INFINITY};
    }
    const float first = (lower - origin) / direction;
    const float second = (upper - origin) / direction;
    return (cut_range_t){smaller(first, second), larger(first, second)};
}

// The cut is stored from the eye, which loses nothing where the eye is far away.
INLINED cut_range_t find_cut_range(const global view_t *view, const world_ray_t *ray)
{
    float3 origin = ray->origin - load3(view->eye);
#if !LONE
    origin += ray->origin_low - load3(view->eye_low);
#endif
    const float3 direction = ray->direction;
    if (view->cut == CUT_PLANE) {
        const float3 normal = load3(view->cut_normal);
        const float height = view->cut_height + dot_product(origin, normal);
        const float rising = dot_product(direction, normal);
        const float crossing = -height / rising;
        if (rising == 0.0f) {
            return (cut_range_t){height > 0.0f ? -INFINITY : INFINITY, height > 0.0f ? INFINITY : -INFINITY};
        }
        return (cut_range_t){rising > 0.0f ? crossing : -INFINITY, rising > 0.0f ? INFINITY : crossing};
    }
    const cut_range_t x = find_slab_range(origin.x, direction.x, view->cut_lower[0], view->cut_upper[0]);
    const cut_range_t y = find_slab_range(origin.y, direction.y, view->cut_lower[1], view->cut_upper[1]);
    const cut_range_t z = find_slab_range(origin.z, direction.z, view->cut_lower[2], view->cut_upper[2]);
    return (cut_range_t){larger(larger(x.begin, y.begin), z.begin), smaller(smaller(x.end, y.end), z.end)};
}

#endif

// Finds the closest hit of a ray that is not cut away: before the cut, or else behind it. Nothing is cut away from rays
// that are not the camera's; both kinds are traversed here, so that a kernel has one copy of the traversal.
INLINED void traverse_shown(
    const world_t *world, const global view_t *view, const world_ray_t *ray, const bool is_primary,
    const bool at_start, search_t *search)
{
#if HAS_CUT
    cut_range_t cut = {INFINITY, -INFINITY};
    if (is_primary && view->cut) {
        cut = find_cut_range(view, ray);
    }
    const bool is_cut = cut.begin <= cut.end;
    for (int side = 0; side < 2 && !is_found(&search->nearest); side++) {
        world_ray_t part = *ray;
        if (side > 0) {
            part.t_min = is_cut ? larger(cut.end, 0.0f) : INFINITY;
        } else if (is_cut) {
            part.t_max = smaller(part.t_max, cut.begin);
        }
        if (part.t_min <= part.t_max && part.t_min < INFINITY) {
            traverse_world(world, &part, at_start, search, QUERY_CLOSEST);
        }
    }
#else
    traverse_world(world, ray, at_start, search, QUERY_CLOSEST);
#endif
}
