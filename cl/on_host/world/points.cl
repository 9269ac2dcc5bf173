// Points in arrays of the user that the host looks up in a world, in the place of world/points.cl. A work-item packs
// its point, and computes in double what it has found.
//
// Arguments that the kernels share, besides those of cl/rays/arrays.cl, of which points are the origins, and those of
// cl/nearest/refine.cl:
//
// directions, t_mins  NULL
// t_maxs              how far away a primitive may be, in the file's unit
// box[7]              of the world, see cl/rays/pack.cl
// order[ray_count]    the points to look up, by their numbers; NULL: all in their own order
// bad                 lowered to the number of a point that is not finite, or too far; it sees nothing
//
// What kernels write, where it is not their own; the results are by the numbers of points, these by their places:
//
// hits[ray_count * slots], candidates[ray_count * slots]    overwritten
// is_crowded[ray_count]      written: whether the slots of a point are too few
// slots                      at least `count`
// is_single                  whether `count` is 1
// count                      results per point
//
// Work-items: (ray_count), rounded up to whole work-groups.

#include "nearest/choose.cl"
#include "nearest/refine.cl"
#include "points/pack.cl"
#include "points/point.cl"
#include "rays/arrays.cl"
#include "world/world.cl"

#define POINT_ARGUMENTS \
    ARRAY_ARGUMENTS, const global double *restrict box, const global int *restrict order, global int *restrict bad
#define PRIM_ARGUMENTS REFINED_ARGUMENTS
#define SLOT_ARGUMENTS \
    global kept_hit_t *restrict hits, global candidate_t *restrict candidates, global uchar *restrict is_crowded, \
    REFINED_ARGUMENTS, const int slots, const int is_single, const int count

// Prefetch distance in points, for points in an order of their own.
#define COMING_POINTS 16

// A point of the user, and the same as it is looked up.
typedef struct {
    double3 wide;
    point_pair_t pair;
} given_point_t;

INLINED float load_limit(const ray_arrays_t *arrays, const ray_place_t *place, const tree_box_t *box)
{
    return localize_limit(*(const double *)(arrays->t_maxs + place->at[T_MAXS_COLUMN]), box);
}

INLINED given_point_t
take_point(const ray_arrays_t *arrays, const int number, const tree_box_t *box, int *bad)
{
    const ray_place_t place = find_ray_place(arrays, number);
    given_point_t given = {
        load_origin(arrays, &place), {0.0f, 0.0f, load_mask(arrays, &place), load_limit(arrays, &place, box)}};
    const double3 local_point = localize_point(given.wide, box);
    if (!is_finite_point(local_point)) {
        atomic_min(bad, number);
        given.pair.mask = 0;
        return given;
    }
    float high[3], low[3];
    store_vector(come_near(local_point, box), high, low);
    given.pair.position = load3(high);
    given.pair.position_low = load3(low);
    return given;
}

// Asks for a point that is looked up later.
INLINED void will_read_point(const ray_arrays_t *arrays, const int number)
{
    const ray_place_t place = find_ray_place(arrays, number);
    WILL_READ(arrays->origins + place.at[ORIGINS_COLUMN]);
}

INLINED bool is_in_box(const double3 local_point, const double3 half_size)
{
    const double3 sizes = fabs(local_point);
    return sizes.x <= half_size.x && sizes.y <= half_size.y && sizes.z <= half_size.z;
}

// Declares what cl/world/points.cl does, and the point as the user `given` it.
#define OPEN_POINT \
    const int place = get_global_id(0); \
    if (place >= ray_count) { \
        return; \
    } \
    const int point_id = order ? order[place] : place; \
    const ray_arrays_t arrays = ARRAYS; \
    if (order && place + COMING_POINTS < ray_count) { \
        will_read_point(&arrays, order[place + COMING_POINTS]); \
    } \
    const tree_box_t tree_box = load_tree_box(box); \
    const given_point_t given = take_point(&arrays, point_id, &tree_box, bad); \
    const point_pair_t point = given.pair

// The share by which the box is grown before a point is said to be outside: float32 has rounded it.
#define IS_IN_BOX is_in_box(localize_point(given.wide, &tree_box), tree_box.half_size * (1.0 + 0x1p-20))

// Writes the closest point of a primitive.
#define WRITE_PRIM(prim) \
    const wide_world_t wide_world = WIDE_WORLD; \
    const found_points_t found = FOUND_POINTS; \
    will_write_closest(&found, point_id); \
    const world_prim_t nearest = (prim); \
    write_closest(&wide_world, given.wide, nearest.instance_id, nearest.prim_id, &found, point_id)

// Writes the nearest of the primitives in a point's slots.
#define CHOOSE_PRIMS() \
    const wide_world_t wide_world = WIDE_WORLD; \
    const found_points_t found = FOUND_POINTS; \
    const found_hits_t found_hits = FOUND_HITS(hits); \
    const long first = (long)place * slots; \
    is_crowded[place] = choose_prims( \
        &wide_world, given.wide, &found_hits, first, slots, candidates + first, count, &found, (long)point_id * count)
