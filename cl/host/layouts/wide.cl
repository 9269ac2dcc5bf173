// The wide nodes of a binary tree, chosen and written: by clbvh/layouts/wide.py, and of many trees by small_trees.py.
//
// Arrays that several loops have:
//
// nodes, prim_ids     the binary tree, whose leaves fit a block; children stand behind their parent
// shares              of each node, see tree/children.cl
// width               most children of a wide node, and most primitives of a block: 4 or 8
// pending             scratch for the nodes that wait

#include "structs.cl"

// The most that there are; a tree may have half of it.
#define TREE_WIDTH 8

// More primitives than a block has.
#define MANY 100

typedef struct {
    const row_node_t *nodes;
    const uint *shares;
    const int *prim_ids;
    int width;
} tree_t;

static int left_of(const tree_t *tree, const int node)
{
    return tree->nodes[node].first;
}

static int right_of(const tree_t *tree, const int node)
{
    return tree->nodes[node].first + 1;
}

static uint shares_of(const tree_t *tree, const int node)
{
    return tree->shares[node];
}

#include "tree/children.cl"
#include "tree/choose.cl"

static void write_leaf(
    row_node_t *node, const int first, const int count, const int *prim_ids, const float (*points)[3],
    const int (*ids)[3])
{
    node->first = first;
    node->count = count;
    for (int axis = 0; axis < 3; axis++) {
        float lower = INFINITY;
        float upper = -INFINITY;
        for (int place = first; place < first + count; place++) {
            for (int corner = 0; corner < 3; corner++) {
                const float coordinate = points[ids[prim_ids[place]][corner]][axis];
                lower = min(lower, coordinate);
                upper = max(upper, coordinate);
            }
        }
        node->aabb_min[axis] = lower;
        node->aabb_max[axis] = upper;
    }
}

// Writes the nodes of a tree, and those that its leaves become where they are too large.
//
// points, ids         see `Corners` of clbvh/geometry/corners.py
loop void split_leaves(
    const long source_count, const row_node_t sources[source_count], const int leaf_size, const long prim_count,
    const int prim_ids[prim_count], const long point_count, const float points[point_count][3],
    const int ids[prim_count][3], const long count, row_node_t nodes[count])
{
    int end = (int)source_count;
    for (int node = 0; node < end; node++) {
        nodes[node] = sources[node];
    }
    for (int node = 0; node < end; node++) {
        const int first = nodes[node].first;
        const int count = nodes[node].count;
        if (count > leaf_size) {
            // The left child gets whole blocks. Both children are split further when the loop reaches them.
            const int left_count = ((count + leaf_size - 1) / leaf_size + 1) / 2 * leaf_size;
            write_leaf(&nodes[end], first, left_count, prim_ids, points, ids);
            write_leaf(&nodes[end + 1], first + left_count, count - left_count, prim_ids, points, ids);
            nodes[node].first = end;
            nodes[node].count = 0;
            end += 2;
        }
    }
}

// Half the surface of a node's box.
static float area_of(const row_node_t *node)
{
    const float x = node->aabb_max[0] - node->aabb_min[0];
    const float y = node->aabb_max[1] - node->aabb_min[1];
    const float z = node->aabb_max[2] - node->aabb_min[2];
    return x * y + y * z + z * x;
}

// Of each node while it chooses.
//
// costs               in column i - 1 the cost as at most i children, for i up to `most`
// most                the number of leaves of the subtree, or the width; 0 where nothing is chosen
// prim_counts         primitives of the subtree, or MANY
// shares              see above
typedef struct {
    float *costs;
    uchar *most;
    uchar *prim_counts;
    uint *shares;
} choices_t;

// Chooses for the nodes of a range whose subtrees lie in it, except for those for which it is done.
static void choose(
    const row_node_t *nodes, const int width, const float block_price, const long begin, const long end,
    const choices_t choices)
{
    uchar *most = choices.most;
    uchar *prim_counts = choices.prim_counts;
    for (long node = end - 1; node >= begin; node--) {
        if (most[node] > 0) {
            continue;
        }
        const float area = area_of(&nodes[node]);
        float *costs = choices.costs + node * width;
        if (nodes[node].count > 0) {
            most[node] = 1;
            prim_counts[node] = nodes[node].count;
            costs[0] = area + block_price;
            choices.shares[node] = 0;
            continue;
        }
        const long left = nodes[node].first;
        const long right = left + 1;
        if (right >= end || most[left] == 0 || most[right] == 0) {
            continue;
        }
        prim_counts[node] = min(MANY, prim_counts[left] + prim_counts[right]);
        most[node] = min(most[left] + most[right], width);
        const float block_cost = prim_counts[node] <= width ? area + block_price : INFINITY;
        choices.shares[node] = choose_children(
            choices.costs + left * width, most[left], choices.costs + right * width, most[right], most[node], area,
            block_cost, costs);
    }
}

// block_price         see `block_price` of clbvh/layouts/wide.py
// costs, most, prim_counts
//                     written, see `choices_t`; `most` is 0 before
loop void choose_range(
    const long count, const row_node_t nodes[count], const int width, const float block_price, const long begin,
    const long end, float costs[count * width], uchar most[count], uchar prim_counts[count], uint shares[count])
{
    choose(nodes, width, block_price, begin, end, (choices_t){costs, most, prim_counts, shares});
}

// Finds up to some number of subtrees of the wide tree, level by level; returns the end of their binary nodes, which
// are the last ones in `pending`, behind the nodes above them.
//
// size                written: the numbers of nodes and blocks above them
loop int cut_tree(
    const long count, const row_node_t nodes[count], const uint shares[count], const int width,
    const int subtree_count, int pending[count], int size[2])
{
    const tree_t tree = {nodes, shares, 0, width};
    int children[TREE_WIDTH];
    int node_count = 0;
    int block_count = 0;
    int end = 1;
    pending[0] = 0;
    while (node_count < end && end - node_count < subtree_count) {
        const int child_count = list_children(&tree, pending[node_count++], width, children);
        for (int slot = 0; slot < child_count; slot++) {
            if (is_block(&tree, children[slot])) {
                block_count++;
            } else {
                pending[end++] = children[slot];
            }
        }
    }
    size[0] = node_count;
    size[1] = block_count;
    return end;
}

static int2 size_below(const tree_t *tree, const int root, int *pending)
{
    int children[TREE_WIDTH];
    int2 size = (int2)(0);
    int pending_count = 1;
    pending[0] = root;
    while (pending_count > 0) {
        const int child_count = list_children(tree, pending[--pending_count], tree->width, children);
        size.x++;
        for (int slot = 0; slot < child_count; slot++) {
            if (is_block(tree, children[slot])) {
                size.y++;
            } else {
                pending[pending_count++] = children[slot];
            }
        }
    }
    return size;
}

// Writes the numbers of nodes and blocks of a subtree of the wide tree.
loop void count_subtree(
    const long count, const row_node_t nodes[count], const uint shares[count], const int width, const int root,
    int pending[count], int size[2])
{
    const tree_t tree = {nodes, shares, 0, width};
    const int2 found = size_below(&tree, root, pending);
    size[0] = found.x;
    size[1] = found.y;
}

// List the primitives of a small subtree in the tree's order, and NO_PRIM behind them.
static void list_prims(const tree_t *tree, const int top, int *prims)
{
    int stack[TREE_WIDTH + 1];
    int stack_size = 1;
    int prim_count = 0;
    stack[0] = top;
    while (stack_size > 0) {
        const row_node_t *node = tree->nodes + stack[--stack_size];
        if (node->count == 0) {
            stack[stack_size++] = node->first + 1;
            stack[stack_size++] = node->first;
        }
        for (int i = 0; i < node->count; i++) {
            prims[prim_count++] = tree->prim_ids[node->first + i];
        }
    }
    while (prim_count < tree->width) {
        prims[prim_count++] = NO_PRIM;
    }
}

// Where a subtree of the wide tree begins: its binary node, its wide node, the next wide node and the next block, and
// the entries on the stack above it.
typedef struct {
    int node;
    int wide_node;
    int next_node;
    int next_block;
    int on_stack;
} start_t;

// Binary nodes, the wide nodes that they become, and the entries on the stack above them.
typedef struct {
    int node;
    int wide_node;
    int on_stack;
} pending_t;

// The subtrees that are left out: their binary nodes, in ascending order, their sizes, and where they start, which is
// written.
typedef struct {
    long count;
    const int *roots;
    const int (*sizes)[2];
    start_t *starts;
} cuts_t;

static long find_cut(const cuts_t *cuts, const int node)
{
    long begin = 0;
    long end = cuts->count;
    while (begin < end) {
        const long middle = (begin + end) / 2;
        if (cuts->roots[middle] < node) {
            begin = middle + 1;
        } else {
            end = middle;
        }
    }
    return begin < cuts->count && cuts->roots[begin] == node ? begin : -1;
}

static void store_child(float *lanes, const int width, const int slot, const row_node_t *child, const int link)
{
    for (int axis = 0; axis < 3; axis++) {
        lanes[axis * width + slot] = child->aabb_min[axis];
        lanes[(3 + axis) * width + slot] = child->aabb_max[axis];
    }
    lanes[6 * width + slot] = as_float(link);
}

static int write_below(
    const tree_t *tree, const start_t start, const cuts_t *cuts, pending_t *pending, float *wide_nodes, int *blocks)
{
    // A missing child has an inverted box.
    const row_node_t no_child = {{FLT_MAX, FLT_MAX, FLT_MAX}, 0, {-FLT_MAX, -FLT_MAX, -FLT_MAX}, 0};
    const int width = tree->width;
    int children[TREE_WIDTH];
    int next_node = start.next_node;
    int next_block = start.next_block;
    int stack_size = 0;
    int pending_count = 1;
    pending[0] = (pending_t){start.node, start.wide_node, start.on_stack};
    while (pending_count > 0) {
        const pending_t own = pending[--pending_count];
        const long cut = find_cut(cuts, own.node);
        if (cut >= 0) {
            cuts->starts[cut] = (start_t){own.node, own.wide_node, next_node, next_block, own.on_stack};
            next_node += cuts->sizes[cut][0] - 1;
            next_block += cuts->sizes[cut][1];
            continue;
        }
        float *lanes = wide_nodes + 7 * width * (long)own.wide_node;
        const int child_count = list_children(tree, own.node, width, children);
        // While a child is visited, its siblings and those of all its ancestors are on the stack.
        const int on_stack = own.on_stack + child_count - 1;
        stack_size = max(stack_size, on_stack);
        for (int slot = 0; slot < child_count; slot++) {
            const int child = children[slot];
            if (is_block(tree, child)) {
                store_child(lanes, width, slot, &tree->nodes[child], ~next_block);
                list_prims(tree, child, blocks + width * (long)next_block++);
            } else {
                store_child(lanes, width, slot, &tree->nodes[child], next_node);
                pending[pending_count++] = (pending_t){child, next_node++, on_stack};
            }
        }
        for (int slot = child_count; slot < width; slot++) {
            store_child(lanes, width, slot, &no_child, 0);
        }
    }
    return stack_size;
}

// Writes the wide nodes and the blocks from a node down to some subtrees; returns the most entries on the stack of a
// traversal.
//
// start, roots, sizes, starts
//                     see `start_t` and `cuts_t`
// pending             see `pending_t`
loop int write_nodes(
    const long count, const row_node_t nodes[count], const uint shares[count], const long prim_count,
    const int prim_ids[prim_count], const int width, const int start[5], const long cut_count,
    const int roots[cut_count], const int sizes[cut_count][2], int starts[cut_count][5],
    int pending[count][3], float *wide_nodes, int *blocks)
{
    const tree_t tree = {nodes, shares, prim_ids, width};
    const cuts_t cuts = {cut_count, roots, sizes, (start_t *)starts};
    return write_below(&tree, *(const start_t *)start, &cuts, (pending_t *)pending, wide_nodes, blocks);
}

// Of many trees: tree i has the nodes and the primitives from first_nodes[i] and first_prims[i] on. Links are those
// within each tree.

// Chooses the wide nodes of some trees, and writes their numbers of nodes and blocks.
loop void choose_trees(
    const long count, const row_node_t nodes[count], const int width, const long tree_count,
    const float block_prices[tree_count], const long first_nodes[tree_count + 1], const long begin, const long end,
    float costs[count * width], uchar most[count], uchar prim_counts[count], uint shares[count], int *pending,
    long sizes[tree_count][2])
{
    for (long i = begin; i < end; i++) {
        const long first = first_nodes[i];
        const tree_t tree = {nodes + first, shares + first, 0, width};
        const choices_t choices = {costs + first * width, most + first, prim_counts + first, shares + first};
        choose(tree.nodes, width, block_prices[i], 0, first_nodes[i + 1] - first, choices);
        const int2 size = size_below(&tree, 0, pending);
        sizes[i][0] = size.x;
        sizes[i][1] = size.y;
    }
}

// Writes the nodes and the blocks of some trees, those of tree i from ends[i] on.
loop void write_trees(
    const long count, const row_node_t nodes[count], const uint shares[count], const int *prim_ids, const int width,
    const long tree_count, int stack_sizes[tree_count], const long first_nodes[tree_count + 1],
    const long first_prims[tree_count + 1], const long ends[tree_count + 1][2], const long begin, const long end,
    int *pending, float *wide_nodes, int *blocks)
{
    const start_t root = {0, 0, 1, 0, 0};
    const cuts_t no_cuts = {0, 0, 0, 0};
    for (long i = begin; i < end; i++) {
        const tree_t tree = {nodes + first_nodes[i], shares + first_nodes[i], prim_ids + first_prims[i], width};
        stack_sizes[i] = write_below(
            &tree, root, &no_cuts, (pending_t *)pending, wide_nodes + 7 * width * ends[i][0],
            blocks + width * ends[i][1]);
    }
}
