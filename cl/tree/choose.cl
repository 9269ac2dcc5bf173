// The cheapest wide nodes that a binary tree contains, bottom-up: `choose_children` of `layouts/wide.py`, for one node
// whose children have chosen already. The same numbers in the same order, so that both choose the same.

// What a child costs as 1 to TREE_WIDTH children, and the nodes and blocks that it makes.
INLINED choice_t load_choice(const tree_t *tree, const int cluster, const float area)
{
    if (!is_leaf(tree, cluster)) {
        return tree->choices[cluster];
    }
    choice_t leaf;
    for (int i = 0; i < TREE_WIDTH; i++) {
        leaf.cost[i] = area + tree->block_price;
        leaf.nodes[i] = 0;
        leaf.blocks[i] = 1;
        leaf.shares[i] = 0;
    }
    return leaf;
}

INLINED void choose_children(
    const tree_t *tree, const int number, const float area, const float left_area, const float right_area)
{
    const global merge_t *merge = tree->merges + number;
    const choice_t left = load_choice(tree, merge->left, left_area);
    const choice_t right = load_choice(tree, merge->right, right_area);
    choice_t choice;
#pragma unroll
    for (int children = 1; children < TREE_WIDTH; children++) {
        // Entry i is for i + 1 children.
        choice.cost[children] = INFINITY;
        choice.shares[children] = 0;
#pragma unroll
        for (int left_children = 0; left_children < children; left_children++) {
            const float cost = left.cost[left_children] + right.cost[children - 1 - left_children];
            if (cost < choice.cost[children]) {
                choice.cost[children] = cost;
                choice.shares[children] = left_children + 1;
            }
        }
        const int share = choice.shares[children];
        choice.nodes[children] = left.nodes[share - 1] + right.nodes[children - share];
        choice.blocks[children] = left.blocks[share - 1] + right.blocks[children - share];
    }

    // As one child: a wide node with the cheapest number of children, or a block.
    choice.cost[0] = choice.cost[TREE_WIDTH - 1] + area;
    choice.shares[0] = choice.shares[TREE_WIDTH - 1];
    choice.nodes[0] = choice.nodes[TREE_WIDTH - 1] + 1;
    choice.blocks[0] = choice.blocks[TREE_WIDTH - 1];
    const float block_cost = area + tree->block_price;
    if (merge->prim_count <= TREE_WIDTH && block_cost <= choice.cost[0]) {
        choice.cost[0] = block_cost;
        choice.shares[0] = 0;
        choice.nodes[0] = 0;
        choice.blocks[0] = 1;
    }
    for (int children = 1; children < TREE_WIDTH; children++) {
        if (choice.cost[children - 1] <= choice.cost[children]) {
            choice.cost[children] = choice.cost[children - 1];
            choice.shares[children] = 0;
            choice.nodes[children] = choice.nodes[children - 1];
            choice.blocks[children] = choice.blocks[children - 1];
        }
    }
    tree->choices[number] = choice;
}
