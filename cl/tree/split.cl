// Where to cut a range of primitive references in two, and how they move to their sides; for the host's builders.
//
// The binned surface area heuristic on three axes, after Wald, "On fast construction of SAH-based bounding volume
// hierarchies" (2007): the centroids of a range fall into equal bins along each axis, in one pass over the references;
// the boundary between two bins with the lowest expected cost is the split. All steps are exact minima and integer
// sums, so bins filled by several threads and then united are bit for bit the bins of one thread.
//
// Of a few primitives every division in two is tried. Most nodes of a tree are this small; it takes less time than
// filling bins, and finds the cheapest division, which need not be a cut along an axis.

#include "boxes/row.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A centroid on the upper bound must fall into the last bin, not behind it, whatever the rounding.
#define BELOW_ONE 0.99999f

// bins / extent must not overflow float32: on an axis along which the centroids lie closer together than this (local
// units), they count as equal.
#define SMALLEST_EXTENT 0x1p-110f

// Prefetch distance in primitive references. A range larger than the caches is read from memory, which the processor
// foresees only within a page: 871,306 references take 3.1 ms instead of 4.2 ms.
#define PREFETCH_DISTANCE 64

// A small range would spend its time on nearly empty bins. With 4 primitives a bin instead of 2, 871,306 primitives
// take 5 % less time and the SAH cost grows by 0.13 %.
#define FEWEST_BINS 4
#define PRIMS_PER_BIN 4

// The boxes of primitives and of their centroids.
typedef struct {
    float8 box;
    float8 centroids;
} bounds_t;

#define EMPTY_BOUNDS (bounds_t){EMPTY_ROW, EMPTY_ROW}

// A box on either side of a split.
typedef struct {
    float8 left;
    float8 right;
} sides_t;

#define EMPTY_SIDES (sides_t){EMPTY_ROW, EMPTY_ROW}

INLINED void add_to_bounds(bounds_t *bounds, const float8 ref)
{
    bounds->box = unite(ref, bounds->box);
    bounds->centroids = unite(doubled_centroid(ref), bounds->centroids);
}

// A plane between two bins of one axis.
//
// cost                half area times count, summed over both sides; infinite when no plane splits the range
// bin_count           bins along the axis
typedef struct {
    double cost;
    int axis;
    int last_left_bin;
    int left_count;
    int bin_count;
} split_t;

// The bins of a range of `prim_count` primitives, at most `bins`.
INLINED int bin_count_for(const int prim_count, const int bins)
{
    return min(bins, max(FEWEST_BINS, prim_count / PRIMS_PER_BIN));
}

// The factors from a centroid's distance to the lower bound to its bin; 0 on a flat axis.
INLINED float8 scales_of(const float8 centroids, const int bin_count)
{
    return bin_scales(centroids, (float)bin_count * BELOW_ONE, SMALLEST_EXTENT);
}

// Unites the references from `begin` to `end`, those of a node or of a slice of it, into bins on the three axes.
//
// Not inlined: bins that are addressed from the stack pointer, as those of the caller would be, let the processor guess
// wrongly which stores a load waits for. So 871,306 triangles take 10 % less time (AMD EPYC).
//
// centroids           the box of all centroids of the node
// bins[3 * bin_count] written, axis by axis: the box of each bin, with the number of its primitives as tally
APART void fill_bins(
    const box_row_t *restrict refs, const long begin, const long end, const float8 centroids, const int bin_count,
    box_row_t *restrict bins)
{
    box_row_t *y_bins = bins + bin_count;
    box_row_t *z_bins = y_bins + bin_count;
    const float8 scales = scales_of(centroids, bin_count);
    for (int bin = 0; bin < 3 * bin_count; bin++) {
        bins[bin] = EMPTY_ROW;
    }
    for (long index = begin; index < end; index++) {
        WILL_READ(&refs[index + PREFETCH_DISTANCE]);
        const float8 ref = refs[index];
        const int4 bin = bins_of(ref, centroids, scales);
        add_to_row(&bins[bin.x], ref);
        add_to_row(&y_bins[bin.y], ref);
        add_to_row(&z_bins[bin.z], ref);
    }
}

// The cheapest boundary between two bins, as `fill_bins` leaves them; of equal costs that on the lowest axis, then that
// of the lowest bin.
//
// Empty bins need no branch: an empty side has an infinite area and no primitives, so its cost is not a number and
// loses every comparison; and a cut behind an empty bin costs as much as the cut before it.
static split_t find_split(const box_row_t *bins, const int bin_count)
{
    // From the right: the cost of everything above each boundary, on all axes at once.
    double right_costs[3][MAX_BINS];
    float8 boxes[3] = {EMPTY_ROW, EMPTY_ROW, EMPTY_ROW};
    int counts[3] = {0, 0, 0};
    for (int bin = bin_count - 1; bin > 0; bin--) {
        for (int axis = 0; axis < 3; axis++) {
            const float8 bin_box = bins[axis * bin_count + bin];
            boxes[axis] = unite(bin_box, boxes[axis]);
            counts[axis] += tally_of(bin_box);
            right_costs[axis][bin] = box_half_area(boxes[axis]) * counts[axis];
        }
    }

    // From the left: the cost of everything below, and the sum.
    split_t best = {.cost = INFINITY, .bin_count = bin_count};
    for (int axis = 0; axis < 3; axis++) {
        float8 box = EMPTY_ROW;
        int left_count = 0;
        for (int bin = 0; bin < bin_count - 1; bin++) {
            const float8 bin_box = bins[axis * bin_count + bin];
            box = unite(bin_box, box);
            left_count += tally_of(bin_box);
            const double cost = box_half_area(box) * left_count + right_costs[axis][bin + 1];
            if (cost < best.cost) {
                best = (split_t){cost, axis, bin, left_count, bin_count};
            }
        }
    }
    return best;
}

// The boxes of both sides: the unions of their bins.
static sides_t unite_sides(const box_row_t *bins, const split_t split)
{
    const box_row_t *axis_bins = bins + split.axis * split.bin_count;
    sides_t boxes = EMPTY_SIDES;
    for (int bin = 0; bin <= split.last_left_bin; bin++) {
        boxes.left = unite(axis_bins[bin], boxes.left);
    }
    for (int bin = split.last_left_bin + 1; bin < split.bin_count; bin++) {
        boxes.right = unite(axis_bins[bin], boxes.right);
    }
    return boxes;
}

// Copies the references from `begin` to `end`, those of a node or of a slice of it, to both sides, in their order, and
// returns the boxes of the centroids there.
//
// The order within a side is that of the source, so slices that are partitioned by several threads, each to slots of
// its own, give bit for bit the result of one thread. It also makes the primitives of every leaf ascend.
//
// source, target      two buffers: a level of the tree reads from one and writes to the other
// left, right         index in the target of the first reference on either side
// centroids           the box of all centroids of the node
static sides_t partition(
    const box_row_t *restrict source, box_row_t *restrict target, const long begin, const long end, long left,
    long right, const float8 centroids, const split_t split)
{
    const int axis = split.axis;
    const float lower = centroids[axis];
    const float scale = scales_of(centroids, split.bin_count)[axis];
    sides_t boxes = EMPTY_SIDES;
    for (long index = begin; index < end; index++) {
        const float8 ref = source[index];
        // The same arithmetic as `bins_of`, on one axis.
        const float centroid = doubled_centroid_on(&source[index], axis);
        const bool is_left = (int)((centroid - lower) * scale) <= split.last_left_bin;
        const int8 mask = (int8)(is_left ? -1 : 0);
        const float8 doubled = doubled_centroid(ref);
        target[is_left ? left : right] = ref;
        left += is_left;
        right += !is_left;
        boxes.left = unite(mask ? doubled : EMPTY_ROW, boxes.left);
        boxes.right = unite(mask ? EMPTY_ROW : doubled, boxes.right);
    }
    return boxes;
}

// A division of at most MAX_EXHAUSTIVE primitives in two: bit i of the mask is set if the i-th goes left.
typedef struct {
    double cost;
    int left_mask;
} division_t;

INLINED division_t cheaper(const division_t best, const double cost, const int left_mask)
{
    return cost < best.cost ? (division_t){cost, left_mask} : best;
}

// The cheapest division of 2 to MAX_EXHAUSTIVE primitives in two. The first one always goes left, and of equal costs
// the division that is tried first wins.
INLINED division_t find_division(const box_row_t *refs, const int prim_count)
{
    const float8 a = refs[0];
    const float8 b = refs[1];
    if (prim_count == 2) {
        return (division_t){box_half_area(a) + box_half_area(b), 1};
    }
    const float8 c = refs[2];
    const float8 ab = unite(a, b);
    const float8 ac = unite(a, c);
    const float8 bc = unite(b, c);
    if (prim_count == 3) {
        division_t best = {box_half_area(a) + 2 * box_half_area(bc), 1};
        best = cheaper(best, 2 * box_half_area(ab) + box_half_area(c), 1 + 2);
        return cheaper(best, 2 * box_half_area(ac) + box_half_area(b), 1 + 4);
    }
    const float8 d = refs[3];
    const float8 ad = unite(a, d);
    const float8 bd = unite(b, d);
    const float8 cd = unite(c, d);
    division_t best = {2 * (box_half_area(ab) + box_half_area(cd)), 1 + 2};
    best = cheaper(best, 2 * (box_half_area(ac) + box_half_area(bd)), 1 + 4);
    best = cheaper(best, 2 * (box_half_area(ad) + box_half_area(bc)), 1 + 8);
    best = cheaper(best, box_half_area(a) + 3 * box_half_area(unite(b, cd)), 1);
    best = cheaper(best, box_half_area(b) + 3 * box_half_area(unite(a, cd)), 1 + 4 + 8);
    best = cheaper(best, box_half_area(c) + 3 * box_half_area(unite(ab, d)), 1 + 2 + 8);
    return cheaper(best, box_half_area(d) + 3 * box_half_area(unite(ab, c)), 1 + 2 + 4);
}

// Copies the references of a range to both sides of a division, in their order, and returns the boxes there.
INLINED sides_t divide(
    const box_row_t *restrict source, box_row_t *restrict target, const long begin, const int prim_count,
    const int left_mask)
{
    long left = begin;
    long right = begin + popcount(left_mask);
    sides_t boxes = EMPTY_SIDES;
    for (int index = 0; index < prim_count; index++) {
        const float8 ref = source[begin + index];
        if (left_mask >> index & 1) {
            target[left++] = ref;
            boxes.left = unite(ref, boxes.left);
        } else {
            target[right++] = ref;
            boxes.right = unite(ref, boxes.right);
        }
    }
    return boxes;
}

static bounds_t find_bounds(const box_row_t *refs, const long begin, const long end)
{
    bounds_t bounds = EMPTY_BOUNDS;
    for (long index = begin; index < end; index++) {
        add_to_bounds(&bounds, refs[index]);
    }
    return bounds;
}
