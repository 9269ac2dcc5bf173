// A tree that can be rearranged: how a finished tree becomes one, how subtrees move to where they enlarge the boxes
// least, and how it becomes a finished tree again. For clbvh/builders/reinsertion.
//
// The moves follow Bittner, Hapala and Havran, "Fast insertion-based optimization of bounding volume hierarchies"
// (2013), with the search of Meister and Bittner, "Parallel reinsertion for bounding volume hierarchy optimization"
// (2018): it starts where the subtree is removed and spreads from there, so most of it stays nearby. The measure is the
// summed area of the interior nodes' boxes; a subtree that moves keeps its own share, and the leaves' never change.
//
// A subtree that moves below a node changes only nodes below that one, so threads can work on disjoint subtrees.

#include "boxes/row.cl"
#include "tree/limits.cl"

#define ROOT 1

// A search ends after this many nodes with the best result so far. The mean is about 20 on scans and 40 on overlapping
// boxes; the limit is for triangles that all overlap, where a search would see the whole tree.
#define MOST_STEPS 2048

// Each step of a search takes one entry off the stack and pushes at most two.
#define SEARCH_STACK_SIZE (MOST_STEPS + 2)

// A move must save this share of the moved box's area, or rounding alone could move a subtree to and fro.
#define LEAST_GAIN 1e-6

// A tree over n primitives, each of them a leaf of its own. Node 1 is the root, node 0 is unused, and siblings are
// nodes 2k and 2k + 1: `node ^ 1` is a node's sibling, and one entry of `parents` serves both.
//
// boxes[2 * n]        the tag is the first child, 0 in a leaf, and the tally is the leaf's primitive
// parents[n]          parents[node >> 1] is the parent of a node; 0 for the root
typedef struct {
    box_row_t *boxes;
    int *parents;
} tree_t;

INLINED int first_child(const box_row_t *boxes, const int node)
{
    return tag_of(boxes[node]);
}

INLINED int parent_of(const tree_t tree, const int node)
{
    return tree.parents[node >> 1];
}

INLINED void store_leaf(const tree_t tree, const int node, const float8 ref)
{
    tree.boxes[node] = with_tally(with_tag(ref, 0), tag_of(ref));
}

INLINED void store_interior(const tree_t tree, const int node, const float8 box, const int child)
{
    tree.boxes[node] = with_tally(with_tag(box, child), 0);
    tree.parents[child >> 1] = node;
}

// Writes the nodes below `top`, level by level, and returns their number.
loop long list_descendants(
    const long node_count, const box_row_t boxes[node_count], const int top, const long size, int descendants[size])
{
    long count = 0;
    long seen = 0;
    int node = top;
    while (true) {
        const int child = first_child(boxes, node);
        if (child != 0) {
            descendants[count] = child;
            descendants[count + 1] = child + 1;
            count += 2;
        }
        if (seen == count) {
            return count;
        }
        node = descendants[seen++];
    }
}

// Writes the number of primitives below each node.
//
// order               all nodes, parents first
loop void count_prims(
    const long node_count, const box_row_t boxes[node_count], const long count, const int order[count],
    int prim_counts[node_count])
{
    for (long index = count - 1; index >= 0; index--) {
        const int node = order[index];
        const int child = first_child(boxes, node);
        prim_counts[node] = child == 0 ? 1 : prim_counts[child] + prim_counts[child + 1];
    }
}

// Sorts the primitives of a leaf, at least two, along the axis of the cheapest split, and returns the number left of
// the split. Of equal costs the more even split is taken, then the lowest axis. O(n^2): for leaves.
loop long sweep(const long count, int prims[count], const long ref_count, const box_row_t refs[ref_count])
{
    int order[3][MAX_LEAF_SIZE];
    double right_costs[MAX_LEAF_SIZE];
    double best_cost = INFINITY;
    int best_axis = 0;
    long best_left = count / 2;
    long best_evenness = -1;
    for (int axis = 0; axis < 3; axis++) {
        // By the doubled centroid; the insertion sort is stable.
        int *sorted = order[axis];
        for (long index = 0; index < count; index++) {
            const float key = doubled_centroid_on(&refs[prims[index]], axis);
            long slot = index;
            while (slot > 0 && doubled_centroid_on(&refs[sorted[slot - 1]], axis) > key) {
                sorted[slot] = sorted[slot - 1];
                slot--;
            }
            sorted[slot] = prims[index];
        }

        float8 box = EMPTY_ROW;
        for (long left_count = count - 1; left_count > 0; left_count--) {
            box = unite(refs[sorted[left_count]], box);
            right_costs[left_count] = box_half_area(box) * (count - left_count);
        }
        box = EMPTY_ROW;
        for (long left_count = 1; left_count < count; left_count++) {
            box = unite(refs[sorted[left_count - 1]], box);
            const double cost = box_half_area(box) * left_count + right_costs[left_count];
            const long evenness = min(left_count, count - left_count);
            if (cost < best_cost || (cost == best_cost && evenness > best_evenness)) {
                best_cost = cost;
                best_axis = axis;
                best_left = left_count;
                best_evenness = evenness;
            }
        }
    }
    for (long index = 0; index < count; index++) {
        prims[index] = order[best_axis][index];
    }
    return best_left;
}

// Some of a leaf's primitives, and their node.
typedef struct {
    int begin;
    int end;
    int node;
} part_t;

// Splits a leaf at the lowest cost until every primitive is alone; returns the next free pair of nodes.
static int split_leaf(
    const tree_t tree, int *prims, const int count, const long ref_count, const box_row_t *refs, const int top,
    int next_pair)
{
    part_t stack[MAX_LEAF_SIZE];
    stack[0] = (part_t){0, count, top};
    int stack_size = 1;
    while (stack_size > 0) {
        const part_t part = stack[--stack_size];
        if (part.end - part.begin == 1) {
            store_leaf(tree, part.node, refs[prims[part.begin]]);
            continue;
        }
        float8 box = EMPTY_ROW;
        for (int index = part.begin; index < part.end; index++) {
            box = unite(refs[prims[index]], box);
        }
        const int middle = part.begin + (int)sweep(part.end - part.begin, prims + part.begin, ref_count, refs);
        store_interior(tree, part.node, box, next_pair);
        stack[stack_size++] = (part_t){middle, part.end, next_pair + 1};
        stack[stack_size++] = (part_t){part.begin, middle, next_pair};
        next_pair += 2;
    }
    return next_pair;
}

// A node of a finished tree, and the same one of a tree that can be rearranged.
typedef struct {
    int finished;
    int expanded;
} pair_t;

// Writes the tree that can be rearranged.
//
// refs                of all primitives, see clbvh/builders/prim_refs.py
loop void expand_leaves(
    const long node_count, const row_node_t nodes[node_count], const long count, const int prim_ids[count],
    const box_row_t refs[count], box_row_t boxes[2 * count], int parents[count])
{
    const tree_t tree = {boxes, parents};
    pair_t stack[MAX_DEPTH + 1];
    stack[0] = (pair_t){0, ROOT};
    int stack_size = 1;
    parents[0] = 0;
    int next_pair = 2;
    while (stack_size > 0) {
        const pair_t pair = stack[--stack_size];
        const row_node_t *node = &nodes[pair.finished];
        if (node->count > 0) {
            int prims[MAX_LEAF_SIZE];
            for (int index = 0; index < node->count; index++) {
                prims[index] = prim_ids[node->first + index];
            }
            next_pair = split_leaf(tree, prims, node->count, count, refs, pair.expanded, next_pair);
            continue;
        }
        store_interior(tree, pair.expanded, row_of_node(node), next_pair);
        stack[stack_size++] = (pair_t){node->first + 1, next_pair + 1};
        stack[stack_size++] = (pair_t){node->first, next_pair};
        next_pair += 2;
    }
}

// The result of a search so far: the largest saving, the new sibling that yields it, and the steps taken.
typedef struct {
    double saving;
    int sibling;
    int steps;
} best_t;

// A node to search, and the saving that is left there.
typedef struct {
    double saving;
    int node;
} position_t;

// Looks for a better sibling among `start` and the nodes below it; returns the best one so far.
//
// A position below a node costs the growth of that node's box, and the area of the new parent, which is at least the
// moved box's own area: the remaining saving bounds the search.
static best_t search(const box_row_t *boxes, const int start, const float8 box, const double saved, best_t best)
{
    position_t stack[SEARCH_STACK_SIZE];
    const double area = box_half_area(box);
    stack[0] = (position_t){saved, start};
    int stack_size = 1;
    while (stack_size > 0 && best.steps < MOST_STEPS) {
        stack_size--;
        const int node = stack[stack_size].node;
        double saving = stack[stack_size].saving;
        if (!(saving - area > best.saving)) {
            continue;
        }
        best.steps++;
        const float8 node_box = boxes[node];
        saving -= box_half_area(unite(node_box, box));
        if (saving > best.saving) {
            best.saving = saving;
            best.sibling = node;
        }
        const int child = tag_of(node_box);
        if (child != 0) {
            saving += box_half_area(node_box);
            if (saving - area > best.saving) {
                stack[stack_size++] = (position_t){saving, child};
                stack[stack_size++] = (position_t){saving, child + 1};
            }
        }
    }
    return best;
}

// The node that would be the best new sibling of `node`; 0 if `node` should stay.
static int find_sibling(const tree_t tree, const int node, const int top)
{
    const box_row_t *boxes = tree.boxes;
    const float8 box = boxes[node];
    int ancestor = parent_of(tree, node);
    // Removing the node removes its parent and shrinks all boxes above.
    float8 rest = boxes[node ^ 1];
    double saved = box_half_area(boxes[ancestor]);
    best_t best = {LEAST_GAIN * box_half_area(box), 0, 0};
    best = search(boxes, node ^ 1, box, saved, best);
    while (ancestor != top) {
        const int sibling = ancestor ^ 1;
        best = search(boxes, sibling, box, saved, best);
        ancestor = parent_of(tree, ancestor);
        rest = unite(rest, boxes[sibling]);
        saved += box_half_area(boxes[ancestor]) - box_half_area(rest);
    }
    return best.sibling;
}

static void copy_node(const tree_t tree, const int source, const int target)
{
    const float8 box = tree.boxes[source];
    tree.boxes[target] = box;
    if (tag_of(box) != 0) {
        tree.parents[tag_of(box) >> 1] = target;
    }
}

// Fits the boxes from a node up to `top` to their children's.
static void fit_upwards(const tree_t tree, int node, const int top)
{
    while (true) {
        const int child = first_child(tree.boxes, node);
        store_interior(tree, node, unite(tree.boxes[child], tree.boxes[child + 1]), child);
        if (node == top) {
            return;
        }
        node = parent_of(tree, node);
    }
}

// Makes `node` the sibling of the subtree at `new_sibling`.
static void move(const tree_t tree, const int node, const int new_sibling, const int top)
{
    // The old sibling takes the slot of the parent, the new sibling takes the slot of the old one, and the slot of the
    // new sibling becomes the parent of the two.
    const int old_sibling = node ^ 1;
    const int parent = parent_of(tree, node);
    copy_node(tree, old_sibling, parent);
    copy_node(tree, new_sibling, old_sibling);
    tree.boxes[new_sibling] = with_tag(tree.boxes[new_sibling], min(node, old_sibling));
    tree.parents[node >> 1] = new_sibling;

    // Boxes above the old position, then above the new one.
    if (parent != top) {
        fit_upwards(tree, parent_of(tree, parent), top);
    }
    fit_upwards(tree, new_sibling, top);
}

// Tries to find a better position for each of the given nodes, one after the other, and returns how many moved.
//
// top                 nodes that are not below this one stay as they are
// order               nodes below `top`
loop long reinsert_below(
    const long count, box_row_t boxes[2 * count], int parents[count], const int top, const long order_count,
    const int order[order_count])
{
    const tree_t tree = {boxes, parents};
    long moves = 0;
    for (long index = 0; index < order_count; index++) {
        const int node = order[index];
        if (parent_of(tree, node) == top) {
            continue;  // the parent is removed with the node, and `top` stays
        }
        const int sibling = find_sibling(tree, node, top);
        if (sibling > 0) {
            move(tree, node, sibling, top);
            moves++;
        }
    }
    return moves;
}

// Marks the leaves of the tree of the lowest SAH cost, and returns the depth of that tree.
//
// Exact: the cheapest form of a subtree does not depend on the rest of the tree. Equal costs make a leaf.
//
// order               all nodes, parents before their children
// costs, prim_counts, heights  of subtrees, in their cheapest form
// is_leaf             written; of no meaning for nodes below a leaf
loop int choose_leaves(
    const long node_count, const box_row_t boxes[node_count], const int leaf_size, const double traversal_cost,
    const long count, const int order[count], double costs[node_count], int prim_counts[node_count],
    int heights[node_count], bool is_leaf[node_count])
{
    for (long index = count - 1; index >= 0; index--) {
        const int node = order[index];
        const double area = box_half_area(boxes[node]);
        const int child = first_child(boxes, node);
        if (child == 0) {
            costs[node] = area;
            prim_counts[node] = 1;
            heights[node] = 0;
            is_leaf[node] = true;
            continue;
        }
        const int prim_count = prim_counts[child] + prim_counts[child + 1];
        const double split_cost = traversal_cost * area + costs[child] + costs[child + 1];
        const bool is_cheaper = prim_count <= leaf_size && prim_count * area <= split_cost;
        prim_counts[node] = prim_count;
        is_leaf[node] = is_cheaper;
        costs[node] = is_cheaper ? prim_count * area : split_cost;
        heights[node] = is_cheaper ? 0 : 1 + max(heights[child], heights[child + 1]);
    }
    return heights[ROOT];
}

// Writes the primitives below a node, ascending, to `prim_ids` from `begin` on, and returns the end.
static int list_prims(const box_row_t *boxes, const int top, int *prim_ids, const int begin)
{
    int stack[MAX_LEAF_SIZE];
    stack[0] = top;
    int stack_size = 1;
    int end = begin;
    while (stack_size > 0) {
        const float8 node = boxes[stack[--stack_size]];
        const int child = tag_of(node);
        if (child != 0) {
            stack[stack_size++] = child + 1;
            stack[stack_size++] = child;
        } else {
            insert_prim(prim_ids, begin, end, tally_of(node));
            end++;
        }
    }
    return end;
}

// Writes the nodes in depth-first order, and returns their number.
//
// is_leaf             of a tree that is at most MAX_DEPTH deep
loop long collapse(
    const long count, const box_row_t boxes[2 * count], const bool is_leaf[2 * count], row_node_t nodes[2 * count],
    int prim_ids[count])
{
    pair_t stack[MAX_DEPTH + 1];
    stack[0] = (pair_t){0, ROOT};
    int stack_size = 1;
    int node_count = 1;
    int prim_count = 0;
    while (stack_size > 0) {
        const pair_t pair = stack[--stack_size];
        const float8 box = boxes[pair.expanded];
        row_node_t *node = &nodes[pair.finished];
        if (is_leaf[pair.expanded]) {
            const int first = prim_count;
            prim_count = list_prims(boxes, pair.expanded, prim_ids, first);
            store_node(node, box, first, prim_count - first);
            continue;
        }
        const int child = tag_of(box);
        store_node(node, box, node_count, 0);
        stack[stack_size++] = (pair_t){node_count + 1, child + 1};
        stack[stack_size++] = (pair_t){node_count, child};
        node_count += 2;
    }
    return node_count;
}
