// The nodes of the binary tree: two clusters that become one, and what its subtree costs.

#include "structs.cl"
#include "tree/prims.cl"

#if TREE_WIDTH == 8
typedef choice8_t choice_t;
#else
typedef choice4_t choice_t;
#endif

// A tree that is being built.
//
// merges[n - 1]       see structs.MERGE
// choices[n - 1]      see structs.WIDE_CHOICES; of wide layouts
// is_node[n - 1]      whether a merge becomes a node of its own
// placements[n - 1]   of those that do, see structs.PLACEMENT
// leaf_size           most primitives in a leaf
// traversal_cost      of a node, in tests of a primitive
// block_price         of the memory of a block in a wide layout, see `layouts/wide.py`
typedef struct {
    prims_t prims;
    global merge_t *merges;
    global choice_t *choices;
    global uchar *is_node;
    global placement_t *placements;
    int leaf_size;
    float traversal_cost;
    float block_price;
} tree_t;

// A cluster is the number of a merge, or ~place of a primitive on the curve.
INLINED bool is_single(const int cluster)
{
    return cluster < 0;
}

INLINED bool is_leaf(const tree_t *tree, const int cluster)
{
    return is_single(cluster) || tree->merges[cluster].interior_count == 0;
}

INLINED int prim_count_of(const tree_t *tree, const int cluster)
{
    return is_single(cluster) ? 1 : tree->merges[cluster].prim_count;
}

INLINED int interior_count_of(const tree_t *tree, const int cluster)
{
    return is_single(cluster) ? 0 : tree->merges[cluster].interior_count;
}

INLINED box_t box_of_cluster(const tree_t *tree, const int cluster)
{
    if (is_single(cluster)) {
        return box_of_prim(tree->prims.points, tree->prims.corners, prim_at(&tree->prims, ~cluster));
    }
    const global merge_t *merge = tree->merges + cluster;
    const box_t box = {load3(merge->aabb_min), load3(merge->aabb_max)};
    return box;
}

#if TREE_WIDTH > 2

#include "tree/choose.cl"

// What a child costs as 1 to TREE_WIDTH children.
INLINED void load_costs(const tree_t *tree, const int cluster, const float area, float *costs)
{
    const bool is_a_leaf = is_leaf(tree, cluster);
    for (int i = 0; i < TREE_WIDTH; i++) {
        costs[i] = is_a_leaf ? area + tree->block_price : tree->choices[cluster].cost[i];
    }
}

INLINED void choose_for_merge(
    const tree_t *tree, const int number, const float area, const float left_area, const float right_area)
{
    const global merge_t *merge = tree->merges + number;
    float left[TREE_WIDTH];
    float right[TREE_WIDTH];
    float costs[TREE_WIDTH];
    load_costs(tree, merge->left, left_area, left);
    load_costs(tree, merge->right, right_area, right);
    const float block_cost = merge->prim_count <= TREE_WIDTH ? area + tree->block_price : INFINITY;
    global choice_t *choice = tree->choices + number;
    choice->shares = choose_children(left, TREE_WIDTH, right, TREE_WIDTH, TREE_WIDTH, area, block_cost, costs);
#pragma unroll
    for (int i = 0; i < TREE_WIDTH; i++) {
        choice->cost[i] = costs[i];
    }
}

#endif

// Make merge `number` of two clusters, whose boxes are given; returns its height.
INLINED int merge_clusters(
    const tree_t *tree, const int number, const int left, const int right, const box_t left_box, const box_t right_box)
{
    const box_t box = unite(left_box, right_box);
    const global merge_t *merges = tree->merges;
    const float left_cost = is_single(left) ? box_area(left_box) : merges[left].cost;
    const float right_cost = is_single(right) ? box_area(right_box) : merges[right].cost;
    const int left_height = is_single(left) ? 0 : merges[left].height;
    const int right_height = is_single(right) ? 0 : merges[right].height;

    // A leaf, where that is as cheap as a node with two children.
    const float area = box_area(box);
    const int prim_count = prim_count_of(tree, left) + prim_count_of(tree, right);
    const float node_cost = area * tree->traversal_cost + (left_cost + right_cost);
    const float leaf_cost = area * (float)prim_count;
    const bool becomes_leaf = prim_count <= tree->leaf_size && leaf_cost <= node_cost;

    global merge_t *merge = tree->merges + number;
    merge->aabb_min[0] = box.lower.x;
    merge->aabb_min[1] = box.lower.y;
    merge->aabb_min[2] = box.lower.z;
    merge->left = left;
    merge->aabb_max[0] = box.upper.x;
    merge->aabb_max[1] = box.upper.y;
    merge->aabb_max[2] = box.upper.z;
    merge->right = right;
    merge->cost = becomes_leaf ? leaf_cost : node_cost;
    merge->prim_count = prim_count;
    merge->interior_count = becomes_leaf ? 0 : 1 + interior_count_of(tree, left) + interior_count_of(tree, right);
    merge->height = 1 + max(left_height, right_height);
    tree->is_node[number] = 0;
#if TREE_WIDTH > 2
    if (!becomes_leaf) {
        choose_for_merge(tree, number, area, box_area(left_box), box_area(right_box));
    }
#endif
    return merge->height;
}
