// The closest points of the primitives that a device found, in double, by clbvh/trace/points/refine.py.
//
// Parameters that the loops share, besides those of cl/nearest/refine.cl:
//
// points[][3]         floats or doubles, by is_double
// order[row_count]    the points, by their numbers
// box[7]              of the world, see cl/rays/pack.cl

#include "structs.cl"
#include "hits/found.cl"
#include "nearest/choose.cl"
#include "nearest/refine.cl"

INLINED double3 load_given(const void *points, const long point, const bool is_double)
{
    const long step = is_double ? sizeof(double) : sizeof(float);
    return load_vector((const char *)points + 3 * point * step, step, is_double);
}

// Writes the closest point of each primitive, to slots.
//
// prims, instances    the primitives, one for each point
loop void refine_points(
    const void *points, const bool is_double, const long row_count, const int order[row_count], const ulong *surfaces,
    const double *ellipsoid_axes, const double *half_lengths, const double box[7], const int prims[row_count],
    const int instances[row_count], const int slots[row_count], double *distances, double *closest, double *us,
    double *vs, int *prim_ids, int *instance_ids)
{
    const wide_world_t world = WIDE_WORLD;
    const found_points_t found = FOUND_POINTS;
    for (long row = 0; row < row_count; row++) {
        const double3 point = load_given(points, order[row], is_double);
        write_closest(&world, point, instances[row], prims[row], &found, slots[row]);
    }
}

// Writes the nearest primitives of each point, `count` of them from its number times that on; returns how many points
// have too few slots, and lists them.
//
// hits, hits_in_world    one of both: [row_count][slot_count], what the device has found, see
//                        cl/kernels/closest_points.cl
// candidates[2 * slot_count]    overwritten
// crowded[row_count]     written
loop long choose_points(
    const void *points, const bool is_double, const long row_count, const int order[row_count], const ulong *surfaces,
    const double *ellipsoid_axes, const double *half_lengths, const double box[7], const hit_t *hits,
    const world_hit_t *hits_in_world, const int slot_count, const int count, double *candidates, int crowded[row_count],
    double *distances, double *closest, double *us, double *vs, int *prim_ids, int *instance_ids)
{
    const wide_world_t world = WIDE_WORLD;
    const found_points_t found = FOUND_POINTS;
    const found_hits_t found_hits = {hits, hits_in_world};
    long crowded_count = 0;
    for (long row = 0; row < row_count; row++) {
        const double3 point = load_given(points, order[row], is_double);
        if (choose_prims(
                &world, point, &found_hits, row * slot_count, slot_count, (candidate_t *)candidates, count, &found,
                (long)order[row] * count)) {
            crowded[crowded_count++] = order[row];
        }
    }
    return crowded_count;
}
