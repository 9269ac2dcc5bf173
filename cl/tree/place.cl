// The nodes of a finished tree, each written where it belongs, top-down: a node gives its children their places.
//
// A tree over so many nodes and primitives has its places from these numbers alone. So every tile is independent of its
// neighbours, and there is no counter. The order is that of `layouts/device_arrays.py` and `layouts/wide.py`.

#include "tree/tile.cl"

// The arrays of the tree: nodes in their layout, and the primitives of the leaves in theirs.
typedef struct {
#if AS_ROWS
    global row_node_t *nodes;
#elif TREE_WIDTH == 2
    global bvh2_node_t *nodes;
#elif TREE_WIDTH == 4
    global bvh4_node_t *nodes;
#else
    global bvh8_node_t *nodes;
#endif
    global int *prims;
    global tree_summary_t *summary;
} output_t;

// Entries on the stack of `list_prims`: a subtree of a wide layout is a block, which has TREE_WIDTH primitives at most.
#define LIST_STACK_SIZE (TREE_WIDTH > 2 ? TREE_WIDTH : MOST_HEIGHT)

// List the primitives of a subtree, leaf after leaf from left to right; those of a leaf ascend.
INLINED void list_prims(const tree_t *tree, const int top, global int *prims)
{
    int stack[LIST_STACK_SIZE];
    int cluster = top;
    int stack_size = 0;
    int leaf_begin = 0;
    int leaf_end = 0;
    for (int i = 0;; i++) {
        for (;;) {
            if (i == leaf_end && is_leaf(tree, cluster)) {
                leaf_begin = i;
                leaf_end = i + prim_count_of(tree, cluster);
            }
            if (is_single(cluster)) {
                break;
            }
            stack[stack_size++] = tree->merges[cluster].right;
            cluster = tree->merges[cluster].left;
        }
        const int prim = prim_at(&tree->prims, ~cluster);
        int slot = i;
        for (; slot > leaf_begin && prims[slot - 1] > prim; slot--) {
            prims[slot] = prims[slot - 1];
        }
        prims[slot] = prim;
        if (stack_size == 0) {
            return;
        }
        cluster = stack[--stack_size];
    }
}

#if TREE_WIDTH == 2

// Write one child of a node, which has its place: the box and the link; and a leaf's primitives.
INLINED void place_child(
    const tree_t *tree, const output_t *output, const int child, const placement_t place, const int node,
    const int side)
{
    const box_t box = box_of_cluster(tree, child);
    const bool is_a_leaf = is_leaf(tree, child);
    const int count = is_a_leaf ? prim_count_of(tree, child) : 0;
    if (is_a_leaf) {
        list_prims(tree, child, output->prims + place.next_block);
    } else {
        tree->is_node[child] = 1;
        tree->placements[child] = place;
    }
#if AS_ROWS
    // Behind the root's row, a pair for each interior node.
    const int first = is_a_leaf ? place.next_block : 2 * place.node + 1;
    global row_node_t *row = output->nodes + (node < 0 ? 0 : 2 * node + 1 + side);
    global float *lower = row->aabb_min;
    global float *upper = row->aabb_max;
    row->first = first;
    row->count = count;
#else
    const int first = is_a_leaf ? place.next_block : place.node;
    global bvh2_node_t *target = output->nodes + max(node, 0);
    global float *lower = target->aabb_min[side];
    global float *upper = target->aabb_max[side];
    target->first[side] = first;
    target->count[side] = count;
#endif
    lower[0] = box.lower.x;
    lower[1] = box.lower.y;
    lower[2] = box.lower.z;
    upper[0] = box.upper.x;
    upper[1] = box.upper.y;
    upper[2] = box.upper.z;
}

INLINED void place_node(const tree_t *tree, const output_t *output, const int number)
{
    const global merge_t *merge = tree->merges + number;
    const placement_t place = tree->placements[number];
    const int left_count = interior_count_of(tree, merge->left);
    placement_t left = {0, 0, place.next_block, place.on_stack + 1};
    placement_t right = {0, 0, place.next_block + prim_count_of(tree, merge->left), place.on_stack + 1};
#if AS_ROWS
    left.node = place.node + 1;
    right.node = left.node + left_count;
#else
    // Siblings are neighbours, and the left one's subtree comes before the right one's.
    left.node = place.next_node;
    right.node = left.node + (left_count > 0);
    left.next_node = right.node + (interior_count_of(tree, merge->right) > 0);
    right.next_node = left.next_node + max(left_count - 1, 0);
#endif
    place_child(tree, output, merge->left, left, place.node, 0);
    place_child(tree, output, merge->right, right, place.node, 1);
    atomic_max(&output->summary->stack_size, place.on_stack + 1);
}

INLINED void place_root(const tree_t *tree, const output_t *output, const int root)
{
    const placement_t place = {0, 1, 0, 0};
#if AS_ROWS
    place_child(tree, output, root, place, -1, 0);
#else
    if (!is_leaf(tree, root)) {
        tree->is_node[root] = 1;
        tree->placements[root] = place;
        return;
    }
    // A tree of one leaf still has one node, whose second child is missing.
    place_child(tree, output, root, place, 0, 0);
    global bvh2_node_t *node = output->nodes;
    for (int axis = 0; axis < 3; axis++) {
        node->aabb_min[1][axis] = GREATEST;
        node->aabb_max[1][axis] = -GREATEST;
    }
    node->first[1] = node->first[0];
    node->count[1] = node->count[0];
#endif
}

#else

INLINED int left_of(const tree_t *tree, const int number)
{
    return tree->merges[number].left;
}

INLINED int right_of(const tree_t *tree, const int number)
{
    return tree->merges[number].right;
}

INLINED uint shares_of(const tree_t *tree, const int cluster)
{
    return is_leaf(tree, cluster) ? 0 : tree->choices[cluster].shares;
}

#include "tree/children.cl"

// Mark the children of a wide node that are nodes, too.
INLINED void mark_children(const tree_t *tree, const int number)
{
    int children[TREE_WIDTH];
    const int child_count = list_children(tree, number, TREE_WIDTH, children);
    for (int i = 0; i < child_count; i++) {
        if (!is_block(tree, children[i])) {
            tree->is_node[children[i]] = 1;
        }
    }
}

// Count the nodes and blocks of a subtree, those of its children being counted.
INLINED void count_subtree(const tree_t *tree, const int number)
{
    int children[TREE_WIDTH];
    const int child_count = list_children(tree, number, TREE_WIDTH, children);
    int node_count = 1;
    int block_count = 0;
    for (int i = 0; i < child_count; i++) {
        const bool is_a_block = is_block(tree, children[i]);
        node_count += is_a_block ? 0 : tree->placements[children[i]].next_node;
        block_count += is_a_block ? 1 : tree->placements[children[i]].next_block;
    }
    tree->placements[number].next_node = node_count;
    tree->placements[number].next_block = block_count;
}

INLINED void place_children(
    const tree_t *tree, const output_t *output, const placement_t place, const int *children, const int child_count)
{
    int block_count = 0;
    int behind_node = place.next_node;
    for (int i = 0; i < child_count; i++) {
        behind_node += !is_block(tree, children[i]);
        block_count += is_block(tree, children[i]);
    }
    const int on_stack = place.on_stack + child_count - 1;
    atomic_max(&output->summary->stack_size, on_stack);

    // Siblings are neighbours, and so are the blocks of a node. Behind them come the subtrees, the last one first.
    int behind_block = place.next_block + block_count;
    placement_t places[TREE_WIDTH];
    int next_node = behind_node;
    for (int i = child_count - 1; i >= 0; i--) {
        behind_node -= !is_block(tree, children[i]);
        const placement_t own = {behind_node, next_node, behind_block, on_stack};
        places[i] = own;
        if (!is_block(tree, children[i])) {
            next_node += tree->placements[children[i]].next_node - 1;
            behind_block += tree->placements[children[i]].next_block;
        }
    }

    int next_block = place.next_block;
    for (int i = 0; i < TREE_WIDTH; i++) {
        box_t box = empty_box();
        int link = 0;
        if (i < child_count) {
            box = box_of_cluster(tree, children[i]);
            if (is_block(tree, children[i])) {
                global int *prims = output->prims + TREE_WIDTH * (long)next_block;
                list_prims(tree, children[i], prims);
                for (int lane = prim_count_of(tree, children[i]); lane < TREE_WIDTH; lane++) {
                    prims[lane] = NO_PRIM;
                }
                link = ~next_block;
                next_block++;
            } else {
                tree->placements[children[i]] = places[i];
                link = places[i].node;
            }
        }
        output->nodes[place.node].aabb_min[0][i] = box.lower.x;
        output->nodes[place.node].aabb_min[1][i] = box.lower.y;
        output->nodes[place.node].aabb_min[2][i] = box.lower.z;
        output->nodes[place.node].aabb_max[0][i] = box.upper.x;
        output->nodes[place.node].aabb_max[1][i] = box.upper.y;
        output->nodes[place.node].aabb_max[2][i] = box.upper.z;
        output->nodes[place.node].child[i] = link;
    }
}

INLINED void place_node(const tree_t *tree, const output_t *output, const int number)
{
    int children[TREE_WIDTH];
    const int child_count = list_children(tree, number, TREE_WIDTH, children);
    place_children(tree, output, tree->placements[number], children, child_count);
}

INLINED void place_root(const tree_t *tree, const output_t *output, const int root)
{
    const placement_t place = {0, 1, 0, 0};
    if (is_block(tree, root)) {
        place_children(tree, output, place, &root, 1);
    } else {
        tree->placements[root] = place;
    }
}

#endif
