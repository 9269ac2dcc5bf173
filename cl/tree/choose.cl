// The cheapest wide nodes that a binary tree contains, bottom-up: `choose_children` of `layouts/wide.py`, for one node
// whose children have chosen already. The same numbers in the same order, so that both choose the same.

// Four bits of `shares` for each number of children, from 1 on.
INLINED int share_of(const uint shares, const int children)
{
    return (int)(shares >> 4 * (children - 1)) & 15;
}

// What a child costs as 1 to TREE_WIDTH children.
INLINED void load_costs(const tree_t *tree, const int cluster, const float area, float *costs)
{
    const bool is_block = is_leaf(tree, cluster);
    for (int i = 0; i < TREE_WIDTH; i++) {
        costs[i] = is_block ? area + tree->block_price : tree->choices[cluster].cost[i];
    }
}

INLINED void choose_children(
    const tree_t *tree, const int number, const float area, const float left_area, const float right_area)
{
    const global merge_t *merge = tree->merges + number;
    float left[TREE_WIDTH];
    float right[TREE_WIDTH];
    load_costs(tree, merge->left, left_area, left);
    load_costs(tree, merge->right, right_area, right);
    // Entry i is for i + 1 children.
    float costs[TREE_WIDTH];
    int shares[TREE_WIDTH];
#pragma unroll
    for (int i = 1; i < TREE_WIDTH; i++) {
        costs[i] = INFINITY;
        shares[i] = 0;
#pragma unroll
        for (int j = 0; j < i; j++) {
            const float cost = left[j] + right[i - 1 - j];
            shares[i] = cost < costs[i] ? j + 1 : shares[i];
            costs[i] = smaller(cost, costs[i]);
        }
    }

    // As one child: a wide node with the cheapest number of children, or a block.
    costs[0] = costs[TREE_WIDTH - 1] + area;
    shares[0] = shares[TREE_WIDTH - 1];
    const float block_cost = area + tree->block_price;
    if (merge->prim_count <= TREE_WIDTH && block_cost <= costs[0]) {
        costs[0] = block_cost;
        shares[0] = 0;
    }
    global choice_t *choice = tree->choices + number;
    uint packed = (uint)shares[0];
    choice->cost[0] = costs[0];
#pragma unroll
    for (int i = 1; i < TREE_WIDTH; i++) {
        const bool is_cheaper = costs[i] < costs[i - 1];
        packed |= (is_cheaper ? (uint)shares[i] : 0) << 4 * i;
        costs[i] = is_cheaper ? costs[i] : costs[i - 1];
        choice->cost[i] = costs[i];
    }
    choice->shares = packed;
}
