// A range of primitives is divided in two, as each builder of the report does at every node, in three ways: by a full
// sort, by `nth_element`, or by buckets. Equal centroids are ordered by primitive id: there is one order, whichever way
// finds it. For cl/host/ladder.
//
// COUNTED as 1: the work is counted, for clbvh/study/ladder_work.py.

#include "boxes/row.cl"
#include "tree/limits.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#ifndef COUNTED
#define COUNTED 0
#endif

// The ways to divide of clbvh/builders/ladder/variants.py.
#define FULL_SORT 0
#define NTH_ELEMENT 1

// Runs of this many primitives are sorted by insertion before they are merged, as sorting libraries do.
#define RUN 8

// The fields of `LadderWork`.
typedef struct {
    long comparisons;
    long bin_lookups;
    long boxes;
    long moves;
    long allocations;
} work_t;

#if COUNTED
#define COUNT(prims, work_done) (prims)->work->work_done++
#else
#define COUNT(prims, work_done)
#endif

// The primitives: the mesh, from which boxes and centroids are computed each time anew, or one box and one centroid of
// each, which were cached. What is not there is null.
typedef struct {
    const float (*vertices)[3];
    const int (*faces)[3];
    const box_row_t *boxes;
    const float (*centroids)[3];
    work_t *work;
} prims_t;

// How a builder divides a node, see `Rule` of clbvh/builders/ladder/steps.py.
typedef struct {
    int how;
    int buckets;
    int leaf_size;
    bool copies;
} rule_t;

// The box around a range of primitives, and the box around their centroids.
typedef struct {
    float8 box;
    float8 centroids;
} bounds_t;

INLINED float8 compute_box(const prims_t *prims, const int prim)
{
    COUNT(prims, boxes);
    const int *face = prims->faces[prim];
    const float8 a = row_of_point(prims->vertices[face[0]]);
    const float8 b = row_of_point(prims->vertices[face[1]]);
    return unite(unite(a, b), row_of_point(prims->vertices[face[2]]));
}

// The centre of a box, in the first three lanes. Halved before they are added: the sum of two large coordinates would
// overflow.
INLINED float8 centre_of(const float8 box)
{
    return 0.5f * box - 0.5f * box.s45670123;
}

INLINED float8 box_of(const prims_t *prims, const int prim)
{
    return prims->boxes ? prims->boxes[prim] : compute_box(prims, prim);
}

// One coordinate of a centroid; of the mesh by the whole box, as in the report's comparison.
INLINED float centroid_of(const prims_t *prims, const int prim, const int axis)
{
    return prims->boxes ? prims->centroids[prim][axis] : centre_of(compute_box(prims, prim))[axis];
}

// Fills the boxes and the centroids of the primitives from `begin` to `end`.
static void cache_metadata(
    const prims_t *mesh, const long begin, const long end, box_row_t *boxes, float (*centroids)[3])
{
    for (long prim = begin; prim < end; prim++) {
        const float8 box = compute_box(mesh, prim);
        boxes[prim] = box;
        vstore3(centre_of(box).s012, prim, centroids[0]);
    }
}

INLINED bounds_t bound_prims(const prims_t *prims, const int *ids, const long count)
{
    bounds_t bounds = {EMPTY_ROW, EMPTY_ROW};
    for (long index = 0; index < count; index++) {
        const int prim = ids[index];
        float centroid[3];
        for (int axis = 0; axis < 3; axis++) {
            centroid[axis] = centroid_of(prims, prim, axis);
        }
        bounds.box = unite(bounds.box, box_of(prims, prim));
        bounds.centroids = unite(bounds.centroids, row_of_point(centroid));
    }
    return bounds;
}

INLINED bool comes_before(const prims_t *prims, const int one, const int other, const int axis)
{
    COUNT(prims, comparisons);
    const float here = centroid_of(prims, one, axis);
    const float there = centroid_of(prims, other, axis);
    return here < there || (here == there && one < other);
}

// Writes the number of a primitive: a move.
INLINED void put(const prims_t *prims, int *slot, const int prim)
{
    COUNT(prims, moves);
    *slot = prim;
}

// Sorts a range along an axis, in O(n log n) comparisons whatever the input.
INLINED void full_sort(const prims_t *prims, int *ids, const long count, const int axis, int *scratch)
{
    for (long first = 0; first < count; first += RUN) {
        for (long index = first + 1; index < min(first + RUN, count); index++) {
            const int prim = ids[index];
            long slot = index;
            for (; slot > first && comes_before(prims, prim, ids[slot - 1], axis); slot--) {
                put(prims, &ids[slot], ids[slot - 1]);
            }
            put(prims, &ids[slot], prim);
        }
    }
    // Merge neighbours: the left run moves to the scratch memory, so that the merged one can overwrite both.
    for (long width = RUN; width < count; width *= 2) {
        for (long first = 0; first < count - width; first += 2 * width) {
            for (long index = 0; index < width; index++) {
                put(prims, &scratch[index], ids[first + index]);
            }
            const long right_end = min(first + 2 * width, count);
            long right = first + width;
            long slot = first;
            for (long left = 0; left < width; slot++) {
                const bool is_right = right < right_end && comes_before(prims, ids[right], scratch[left], axis);
                put(prims, &ids[slot], is_right ? ids[right++] : scratch[left++]);
            }
        }
    }
}

// Moves the primitives that a sort would put before `middle` there, in any order, and the others behind them.
//
// Hoare's selection, O(n) for nearly every input (C. A. R. Hoare, "Algorithm 65: find", 1961). When too many rounds
// have not ended it, a sort of the rest bounds it, as in Musser's introselect (1997).
INLINED void nth_element(
    const prims_t *prims, int *ids, const long count, const long middle, const int axis, int *scratch)
{
    long low = 0;
    long high = count - 1;
    int rounds_left = 0;
    while (1l << rounds_left < count) {
        rounds_left++;
    }
    for (rounds_left *= 2; low < high; rounds_left--) {
        if (rounds_left == 0) {
            full_sort(prims, ids + low, high + 1 - low, axis, scratch);
            return;
        }
        // The median of three as pivot.
        int pivot = ids[low];
        int centre = ids[(low + high) / 2];
        const int last = ids[high];
        if (comes_before(prims, centre, pivot, axis)) {
            const int later = pivot;
            pivot = centre;
            centre = later;
        }
        if (comes_before(prims, last, centre, axis)) {
            centre = comes_before(prims, last, pivot, axis) ? pivot : last;
        }
        pivot = centre;
        // Everything up to `right` comes before everything from `left` on; between them at most the pivot.
        long left = low;
        long right = high;
        while (left <= right) {
            while (comes_before(prims, ids[left], pivot, axis)) {
                left++;
            }
            while (comes_before(prims, pivot, ids[right], axis)) {
                right--;
            }
            if (left <= right) {
                const int prim = ids[left];
                put(prims, &ids[left++], ids[right]);
                put(prims, &ids[right--], prim);
            }
        }
        if (middle <= right) {
            high = right;
        } else if (middle >= left) {
            low = left;
        } else {
            return;
        }
    }
}

// How far apart the centroids lie along an axis. In float64: extents of a mesh that fills float32 do not fit it.
INLINED double extent_of(const bounds_t *bounds, const int axis)
{
    return -(double)bounds->centroids[axis + 4] - (double)bounds->centroids[axis];
}

// The axis along which the centroids lie furthest apart, the lowest of several.
INLINED int find_longest_axis(const bounds_t *bounds)
{
    int longest = 0;
    for (int axis = 1; axis < 3; axis++) {
        if (extent_of(bounds, axis) > extent_of(bounds, longest)) {
            longest = axis;
        }
    }
    return longest;
}

// The buckets along an axis.
typedef struct {
    int axis;
    int count;
    double lower;
    double scale;
} buckets_t;

INLINED int bucket_of(const prims_t *prims, const int prim, const buckets_t *buckets)
{
    COUNT(prims, bin_lookups);
    const double offset = (double)centroid_of(prims, prim, buckets->axis) - buckets->lower;
    return min((int)(offset * buckets->scale), buckets->count - 1);
}

INLINED long distance_of(const long one, const long other)
{
    return one < other ? other - one : one - other;
}

// Cuts the range at the boundary between buckets that is next to the median; both sides keep their order. Returns how
// many primitives are on the left.
INLINED long bucket_partition(
    const prims_t *prims, int *ids, const long count, const buckets_t *buckets, int *scratch)
{
    long counts[MAX_BINS];
    for (int bucket = 0; bucket < buckets->count; bucket++) {
        counts[bucket] = 0;
    }
    for (long index = 0; index < count; index++) {
        counts[bucket_of(prims, ids[index], buckets)]++;
    }

    // The first and the last bucket are never empty, so each boundary leaves something on both sides.
    int last_left = 0;
    long below = counts[0];
    long left_count = below;
    for (int bucket = 1; bucket < buckets->count - 1; bucket++) {
        below += counts[bucket];
        if (distance_of(2 * below, count) < distance_of(2 * left_count, count)) {
            last_left = bucket;
            left_count = below;
        }
    }

    long left = 0;
    long right = 0;
    for (long index = 0; index < count; index++) {
        const int prim = ids[index];
        if (bucket_of(prims, prim, buckets) <= last_left) {
            put(prims, &ids[left++], prim);
        } else {
            put(prims, &scratch[right++], prim);
        }
    }
    for (long index = 0; index < right; index++) {
        put(prims, &ids[left + index], scratch[index]);
    }
    return left;
}

INLINED long divide_prims(
    const prims_t *prims, int *ids, const long count, const int depth, const rule_t *rule, const bounds_t *bounds,
    int *scratch)
{
    const int axis = find_longest_axis(bounds);
    const double extent = extent_of(bounds, axis);
    if (rule->how == FULL_SORT) {
        full_sort(prims, ids, count, axis, scratch);
    } else if (rule->how == NTH_ELEMENT) {
        nth_element(prims, ids, count, count / 2, axis, scratch);
    } else if (extent > 0.0 && !needs_halving((int)count, depth)) {
        const buckets_t buckets = {axis, rule->buckets, bounds->centroids[axis], rule->buckets / extent};
        return bucket_partition(prims, ids, count, &buckets, scratch);
    }
    // Otherwise all centroids fall into one bucket, or no level is left for uneven halves: the cut goes through the
    // median of the primitive ids, by which every range of a partitioning builder is ordered.
    return count / 2;
}

// The two kinds of primitives: both steps are compiled for each of them.
#define CACHED(prims) (prims_t){.boxes = (prims)->boxes, .centroids = (prims)->centroids, .work = (prims)->work}
#define MESH(prims) (prims_t){.vertices = (prims)->vertices, .faces = (prims)->faces, .work = (prims)->work}

// Returns the boxes around a range.
static bounds_t bound_range(const prims_t *prims, const int *ids, const long count)
{
    const prims_t cached = CACHED(prims);
    const prims_t mesh = MESH(prims);
    return prims->boxes ? bound_prims(&cached, ids, count) : bound_prims(&mesh, ids, count);
}

// Reorders a range of at least two primitives, so that the left child's come first; returns how many these are.
//
// depth               that of the node which owns the range
// bounds              those of the range
static long divide(
    const prims_t *prims, int *ids, const long count, const int depth, const rule_t *rule, const bounds_t *bounds,
    int *scratch)
{
    const prims_t cached = CACHED(prims);
    const prims_t mesh = MESH(prims);
    return prims->boxes ? divide_prims(&cached, ids, count, depth, rule, bounds, scratch)
                        : divide_prims(&mesh, ids, count, depth, rule, bounds, scratch);
}
