// Primitive references, and the subtrees of ranges of them, by clbvh/builders/prim_refs.py and clbvh/builders/sah.
//
// A range writes only to its own references and to its own part of prim_ids, so ranges that do not overlap need neither
// a shared counter nor a lock.
//
// Nodes are finished from right to left, and overwrite the references of finished leaves, which nobody needs any more,
// in both buffers: two slots for each primitive. A tree over n primitives has at most 2n - 1 nodes, and the same holds
// for its parts, so there is always a free slot. `slot_of` says where the n-th finished node lies. The order is the
// reverse of depth-first order: all descendants of the right child, all of the left child, then the right child and the
// left child themselves.

#include "tree/limits.cl"
#include "tree/split.cl"

// Writes the references of some primitives, and their bounds: the box, and that of the centroids.
loop void fill_prim_refs(
    const long point_count, const float points[point_count][3], const long count, const int ids[count][3],
    const long begin, const long end, box_row_t refs[count], box_row_t bounds[2])
{
    bounds_t all = EMPTY_BOUNDS;
    for (long prim = begin; prim < end; prim++) {
        const int *corners = ids[prim];
        const float8 box = unite(row_of_point(points[corners[1]]), row_of_point(points[corners[0]]));
        const float8 ref = unite(row_of_point(points[corners[2]]), box);
        refs[prim] = with_tag(ref, (int)prim);
        add_to_bounds(&all, ref);
    }
    bounds[0] = all.box;
    bounds[1] = all.centroids;
}

// A range of references, and in which of the two buffers it is.
typedef struct {
    bounds_t bounds;
    long begin;
    long end;
    int buffer;
} range_t;

// A level of nodes above the current one, whose right child is built first.
//
// left                its end is 0 once it is the current node
// right               the box of the right child, and how it is linked once it is finished
typedef struct {
    range_t left;
    float8 right;
    int right_first;
    int right_count;
} level_t;

// The buffers, of `count` references each, and the end of the range that becomes a subtree.
typedef struct {
    box_row_t *refs;
    long count;
    long end;
} buffers_t;

// Where the n-th finished node of a range lies.
INLINED box_row_t *slot_of(const buffers_t *buffers, const long number)
{
    return buffers->refs + (number & 1) * buffers->count + buffers->end - 1 - (number >> 1);
}

INLINED void emit_node(
    const buffers_t *buffers, const long number, const float8 box, const int first, const int count)
{
    store_node((row_node_t *)slot_of(buffers, number), box, first, count);
}

// Builds the subtree over one range, and returns its number of nodes.
//
// refs                two buffers of references. Afterwards they hold the nodes, see `slot_of`, except that an interior
//                     node's `first` is its left child's number. The root is the last one.
// depth               of the root in the whole tree
// bounds              of the range: the box, and that of the centroids
// bins, leaf_size, traversal_cost  see `BuildOptions`
loop long build_subtree(
    const long count, box_row_t refs[2 * count], const long begin, const long end, const int buffer, const int depth,
    const box_row_t bounds[2], const int bins, const int leaf_size, const double traversal_cost, int prim_ids[count])
{
    const buffers_t buffers = {refs, count, end};
    float8 bin_rows[3 * MAX_BINS];
    level_t levels[MAX_DEPTH + 1];
    range_t node = {{bounds[0], bounds[1]}, begin, end, buffer};
    int level = 0;
    int node_count = 0;
    while (true) {
        const int prim_count = (int)(node.end - node.begin);
        const box_row_t *source = refs + node.buffer * count;
        box_row_t *target = refs + (1 - node.buffer) * count;
        const bool is_small = prim_count <= MAX_EXHAUSTIVE;

        // Try to split the node.
        division_t division = {INFINITY, 0};
        split_t split;
        if (prim_count > 1 && !needs_halving(prim_count, depth + level)) {
            if (is_small) {
                division = find_division(source + node.begin, prim_count);
            } else {
                const int bin_count = bin_count_for(prim_count, bins);
                fill_bins(source, node.begin, node.end, node.bounds.centroids, bin_count, bin_rows);
                split = find_split(bin_rows, bin_count);
                division.cost = split.cost;
            }
        }

        const double area = box_half_area(node.bounds.box);
        const bool is_cheaper = traversal_cost * area + division.cost < prim_count * area;
        if (prim_count > leaf_size || is_cheaper) {
            // Move its references to their sides, into the other buffer; halves stay where they are.
            range_t left = node;
            range_t right = node;
            if (!(division.cost < INFINITY)) {
                left.end = middle_of(node.begin, node.end);
                left.bounds = find_bounds(source, node.begin, left.end);
                right.bounds = find_bounds(source, left.end, node.end);
            } else {
                sides_t boxes;
                left.buffer = right.buffer = 1 - node.buffer;
                if (is_small) {
                    left.end = node.begin + popcount(division.left_mask);
                    boxes = divide(source, target, node.begin, prim_count, division.left_mask);
                } else {
                    left.end = node.begin + split.left_count;
                    boxes = unite_sides(bin_rows, split);
                    const sides_t centroids = partition(
                        source, target, node.begin, node.end, node.begin, left.end, node.bounds.centroids, split);
                    left.bounds.centroids = centroids.left;
                    right.bounds.centroids = centroids.right;
                }
                left.bounds.box = boxes.left;
                right.bounds.box = boxes.right;
            }

            // The left child goes on the stack, the right one is next.
            right.begin = left.end;
            levels[level].left = left;
            levels[level].right = right.bounds.box;
            node = right;
            level++;
            continue;
        }

        // A leaf, its primitives in ascending order already; perhaps the last one below some of the nodes above.
        for (long index = node.begin; index < node.end; index++) {
            prim_ids[index] = tag_of(source[index]);
        }
        int first = (int)node.begin;
        int leaf_count = prim_count;
        while (level > 0 && levels[level - 1].left.end == 0) {
            level--;
            const level_t *above = &levels[level];
            emit_node(&buffers, node_count, above->right, above->right_first, above->right_count);
            emit_node(&buffers, node_count + 1, above->left.bounds.box, first, leaf_count);
            first = node_count + 1;
            leaf_count = 0;
            node_count += 2;
        }
        if (level == 0) {
            emit_node(&buffers, node_count, bounds[0], first, leaf_count);
            return node_count + 1;
        }

        // A right child is finished; the left one is next.
        level_t *above = &levels[level - 1];
        above->right_first = first;
        above->right_count = leaf_count;
        node = above->left;
        above->left.end = 0;
    }
}

// Where a subtree goes in the finished tree: the indices of its root, and of the first of the root's descendants.
typedef struct {
    long root;
    long below;
} placed_t;

// The index of the node with this number in a subtree.
INLINED long index_of(const placed_t placed, const long number)
{
    return number == 0 ? placed.root : placed.below + number - 1;
}

// Copies a finished subtree to its indices, and lets its nodes name their children by these.
static void place_subtree(const buffers_t buffers, const long node_count, const placed_t placed, row_node_t *nodes)
{
    // Nodes are finished in the reverse of depth-first order.
    const long last = node_count - 1;
    for (long number = 0; number < node_count; number++) {
        const float8 node = *slot_of(&buffers, last - number);
        const bool is_interior = tally_of(node) == 0;
        *(box_row_t *)&nodes[index_of(placed, number)] =
            is_interior ? with_tag(node, (int)index_of(placed, last - tag_of(node))) : node;
    }
}

// Copies some subtrees to their indices.
//
// subtrees            the end of the range, the number of nodes, the index of the root, that of the first node below
loop void place_subtrees(
    const long count, box_row_t refs[2 * count], const long subtree_count, const long subtrees[subtree_count][4],
    const long node_count, row_node_t nodes[node_count])
{
    for (long number = 0; number < subtree_count; number++) {
        const long *subtree = subtrees[number];
        place_subtree((buffers_t){refs, count, subtree[0]}, subtree[1], (placed_t){subtree[2], subtree[3]}, nodes);
    }
}

// Builds the trees over some shapes.
//
// points              of all shapes; `ids` are numbers of the points of a shape
// first_points, first_prims   where those of each shape begin
// refs                two buffers for each shape, overwritten
// nodes               those of a shape begin at twice the number of the primitives before it
loop void build_trees(
    const long point_count, const float points[point_count][3], const long count, const int ids[count][3],
    const long bound_count, const long first_points[bound_count], const long first_prims[bound_count],
    const int bins, const int leaf_size, const double traversal_cost, const long first_shape, const long end_shape,
    box_row_t refs[2 * count], int prim_ids[count], row_node_t nodes[2 * count], long node_counts[bound_count - 1])
{
    for (long shape = first_shape; shape < end_shape; shape++) {
        const long begin = first_prims[shape];
        const long prim_count = first_prims[shape + 1] - begin;
        box_row_t *own_refs = refs + 2 * begin;
        box_row_t bounds[2];
        fill_prim_refs(
            point_count, points + first_points[shape], prim_count, ids + begin, 0, prim_count, own_refs, bounds);
        node_counts[shape] = build_subtree(
            prim_count, own_refs, 0, prim_count, 0, 0, bounds, bins, leaf_size, traversal_cost, prim_ids + begin);
        const buffers_t buffers = {own_refs, prim_count, prim_count};
        place_subtree(buffers, node_counts[shape], (placed_t){0, 1}, nodes + 2 * begin);
    }
}
