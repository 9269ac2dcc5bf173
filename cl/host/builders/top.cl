// The top of the tree, by all threads at once: the steps of one level, by clbvh/builders/sah/top.py, which names the
// arrays. A node of the level is cut into slices, one for each thread.

#include "tree/limits.cl"
#include "tree/split.cl"

// A node: a range of references, and in which of the two buffers it is.
typedef struct {
    long begin;
    long end;
    long buffer;
} range_t;

// Where the slice of a node with this number begins, and the one before it ends.
INLINED long slice_begin(const range_t range, const long slice_count, const long slice)
{
    return range.begin + (range.end - range.begin) * slice / slice_count;
}

// Fills the bins of one slice of each node.
//
// most_bins           bins along an axis; a small node has fewer
loop void bin_slices(
    const long count, const box_row_t refs[2 * count], const long node_count, const long ranges[node_count][3],
    const box_row_t bounds[node_count][2], const long slice_count, const long slice, const long most_bins,
    box_row_t bins[node_count * slice_count * 3 * most_bins])
{
    for (long node = 0; node < node_count; node++) {
        const range_t range = *(const range_t *)ranges[node];
        fill_bins(
            refs + range.buffer * count, slice_begin(range, slice_count, slice),
            slice_begin(range, slice_count, slice + 1), bounds[node][1],
            bin_count_for((int)(range.end - range.begin), (int)most_bins),
            bins + (node * slice_count + slice) * 3 * most_bins);
    }
}

// Unites the bins of all slices of a node.
static void unite_bins(
    const box_row_t *slices, const long slice_count, const long most_bins, const int row_count, box_row_t *united)
{
    for (int row = 0; row < row_count; row++) {
        float8 box = EMPTY_ROW;
        int tally = 0;
        for (long slice = 0; slice < slice_count; slice++) {
            const float8 other = slices[slice * 3 * most_bins + row];
            tally += tally_of(other);
            box = unite(other, box);
        }
        united[row] = with_tally(box, tally);
    }
}

// Finds the split of each node, and where each slice's references go.
//
// depth               of the level in the tree
// splits              written: the axis, the last bin on the left, the references there, and the bins along the axis; 0
//                     references where no plane splits the node
// boxes               written: of both sides of the split
// targets             written: index in the other buffer of each slice's first reference on either side
loop void choose_splits(
    const long node_count, const long ranges[node_count][3], const long slice_count, const long most_bins,
    const box_row_t bins[node_count * slice_count * 3 * most_bins], const int depth, int splits[node_count][4],
    box_row_t boxes[node_count][2], long targets[node_count * slice_count][2])
{
    float8 united[3 * MAX_BINS];
    for (long node = 0; node < node_count; node++) {
        const range_t range = *(const range_t *)ranges[node];
        const int prim_count = (int)(range.end - range.begin);
        const int bin_count = bin_count_for(prim_count, (int)most_bins);
        const box_row_t *slices = bins + node * slice_count * 3 * most_bins;
        unite_bins(slices, slice_count, most_bins, 3 * bin_count, united);
        const split_t split = find_split(united, bin_count);
        const bool is_split = split.cost < INFINITY && !needs_halving(prim_count, depth);
        splits[node][0] = split.axis;
        splits[node][1] = split.last_left_bin;
        splits[node][2] = is_split ? split.left_count : 0;
        splits[node][3] = bin_count;
        if (!is_split) {
            continue;
        }
        const sides_t sides = unite_sides(united, split);
        boxes[node][0] = sides.left;
        boxes[node][1] = sides.right;

        // The bins of a slice say how many of its references go left.
        long left = range.begin;
        long right = range.begin + split.left_count;
        for (long slice = 0; slice < slice_count; slice++) {
            long *target = targets[node * slice_count + slice];
            target[0] = left;
            target[1] = right;
            const box_row_t *axis_bins = slices + slice * 3 * most_bins + split.axis * bin_count;
            long left_count = 0;
            for (int bin = 0; bin <= split.last_left_bin; bin++) {
                left_count += tally_of(axis_bins[bin]);
            }
            left += left_count;
            right += slice_begin(range, slice_count, slice + 1) - slice_begin(range, slice_count, slice) - left_count;
        }
    }
}

// Moves one slice of each node that is split to its sides.
//
// centroids           written: the boxes of the centroids on both sides of each slice
loop void partition_slices(
    const long count, box_row_t refs[2 * count], const long node_count, const long ranges[node_count][3],
    const box_row_t bounds[node_count][2], const int splits[node_count][4], const long slice_count, const long slice,
    const long targets[node_count * slice_count][2], box_row_t centroids[node_count * slice_count][2])
{
    for (long node = 0; node < node_count; node++) {
        if (splits[node][2] == 0) {
            continue;
        }
        const range_t range = *(const range_t *)ranges[node];
        const split_t split = {0.0, splits[node][0], splits[node][1], splits[node][2], splits[node][3]};
        const long number = node * slice_count + slice;
        const sides_t sides = partition(
            refs + range.buffer * count, refs + (1 - range.buffer) * count, slice_begin(range, slice_count, slice),
            slice_begin(range, slice_count, slice + 1), targets[number][0], targets[number][1], bounds[node][1], split);
        centroids[number][0] = sides.left;
        centroids[number][1] = sides.right;
    }
}
