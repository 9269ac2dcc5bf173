// The nearest of some primitives, chosen by distances in double.

#include "structs.cl"
#include "hits/found.cl"
#include "nearest/refine.cl"
#include "points/pack.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// Distances that differ by less than this share of themselves and of the point's coordinates are ties: doubles round
// those of triangles that share an edge by less than that, each in its own way.
#define TIE_SHARE 0x1p-46

typedef struct {
    double distance;
    int prim_id;
    int instance_id;
} candidate_t;

INLINED bool is_earlier_by_ids(const candidate_t *a, const candidate_t *b)
{
    return a->instance_id < b->instance_id || (a->instance_id == b->instance_id && a->prim_id < b->prim_id);
}

INLINED bool is_earlier(const candidate_t *a, const candidate_t *b, const bool by_distance)
{
    if (by_distance && a->distance != b->distance) {
        return a->distance < b->distance;
    }
    return is_earlier_by_ids(a, b);
}

// Sinks a candidate from a place in a heap whose last one is on top.
INLINED void sink_candidate(
    candidate_t *heap, const int count, int place, const candidate_t candidate, const bool by_distance)
{
    while (2 * place + 1 < count) {
        int child = 2 * place + 1;
        child += child + 1 < count && is_earlier(heap + child, heap + child + 1, by_distance);
        if (!is_earlier(&candidate, heap + child, by_distance)) {
            break;
        }
        heap[place] = heap[child];
        place = child;
    }
    heap[place] = candidate;
}

// Sorts candidates by their distance and then their ids, or by their ids alone. Many may be equally near.
INLINED void sort_candidates(candidate_t *candidates, const int count, const bool by_distance)
{
    for (int place = count / 2 - 1; place >= 0; place--) {
        sink_candidate(candidates, count, place, candidates[place], by_distance);
    }
    for (int end = count - 1; end > 0; end--) {
        const candidate_t last = candidates[end];
        candidates[end] = candidates[0];
        sink_candidate(candidates, end, 0, last, by_distance);
    }
}

// Whether points in local coordinates are looked up where they are, see `come_near`.
INLINED bool is_near_world(const double3 point, const tree_box_t *box)
{
    return largest_size(localize_point(point, box)) <= FAR_POINT_SHARE * largest_size(box->half_size);
}

// Writes the nearest primitives of a point, nearest first, in the order of (instance, primitive) where they are equally
// near. Returns whether one that was left out may belong to them.
//
// hits, first, room   what was found, see kernels/closest_points.cl
// candidates[room]    overwritten
// count               how many are wanted, `room` at most
// slot                of the first one
INLINED bool choose_prims(
    const wide_world_t *world, const double3 point, const found_hits_t *hits, const long first, const int room,
    candidate_t *candidates, const int count, const found_points_t *found, const long slot)
{
    for (int number = 0; number < room; number++) {
        const int prim = prim_of(hits, first + number);
        const int instance = prim == NO_PRIM ? NO_PRIM : instance_of(hits, first + number);
        candidates[number].distance = find_closest(world, point, instance, prim).distance;
        candidates[number].prim_id = prim;
        candidates[number].instance_id = instance;
    }
    sort_candidates(candidates, room, true);
    const double size = largest_size(point);
    const double farthest = candidates[count - 1].distance;
    // In ascending order: those of ties differ by their rounding alone.
    for (int number = 0; number < count; number++) {
        found->distances[slot + number] = candidates[number].distance;
    }
    int begin = 0;
    while (begin < count) {
        int end = begin + 1;
        while (end < room) {
            const double before = candidates[end - 1].distance;
            if (candidates[end].distance - before > TIE_SHARE * (size + before)) {
                break;
            }
            end++;
        }
        sort_candidates(candidates + begin, end - begin, false);
        begin = end;
    }
    for (int number = 0; number < count; number++) {
        const candidate_t *chosen = candidates + number;
        const double distance = found->distances[slot + number];
        write_closest(world, point, chosen->instance_id, chosen->prim_id, found, slot + number);
        found->distances[slot + number] = distance;
    }
    const double least_left = t_of(hits, first) / world->box.scale;
    return prim_of(hits, first + room - 1) != NO_PRIM && least_left <= farthest + TIE_SHARE * (size + farthest)
        && is_near_world(point, &world->box);
}
