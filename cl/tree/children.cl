// The nodes of a binary tree that become the children of a wide node.
//
// Assumes TREE_WIDTH, the most children of a node; tree_t; and three functions of a tree and a node: shares_of, 0 of a
// leaf, left_of and right_of.
//
// The shares of a node that becomes at most i children have as their bits 4 (i - 1) to 4 i - 1 how many of these its
// left half becomes; 0 where i - 1 children are as cheap. For i = 1 they are those of a wide node's own children; 0 of
// a block.

#include "math/numeric.cl"

INLINED int share_of(const uint shares, const int children)
{
    return (int)(shares >> 4 * (children - 1)) & 15;
}

INLINED bool is_block(const tree_t *tree, const int node)
{
    return share_of(shares_of(tree, node), 1) == 0;
}

// Lists the children of the wide node that a node becomes, from left to right; returns their number. Of a block it is
// the block.
INLINED int list_children(const tree_t *tree, const int top, const int width, int *children)
{
    int stack[TREE_WIDTH + 1];
    int shares[TREE_WIDTH + 1];
    int node = top;
    int share = width;
    int left_share = share_of(shares_of(tree, top), 1);
    int stack_size = 0;
    int count = 0;
    for (;;) {
        if (left_share > 0) {
            stack[stack_size] = right_of(tree, node);
            shares[stack_size++] = share - left_share;
            node = left_of(tree, node);
            share = left_share;
        } else {
            children[count++] = node;
            if (stack_size == 0) {
                return count;
            }
            node = stack[--stack_size];
            share = shares[stack_size];
        }
        const uint own = shares_of(tree, node);
        left_share = 0;
        while (own != 0 && share > 1 && (left_share = share_of(own, share)) == 0) {
            share--;
        }
    }
}
