// The cheapest wide nodes that a binary tree contains, bottom-up: the choice of one node whose halves have chosen.
//
// Of devices that build trees and of the host, `layouts/wide.py`: the same numbers in the same order, in float32, so
// that both choose the same.
//
// Assumes TREE_WIDTH, the most children of a node.

#include "math/numeric.cl"

// Chooses for a node, and returns its shares, see tree/children.cl.
//
// left, right         what the halves cost as at most 1 to left_most and right_most children
// most                of the node: left_most + right_most, or as many as a wide node has
// area                half the surface of its box
// block_cost          what it costs as a block; INFINITY if it has too many primitives for one
// costs               what it costs as at most 1 to `most` children; written
INLINED uint choose_children(
    const float *left, const int left_most, const float *right, const int right_most, const int most, const float area,
    const float block_cost, float *costs)
{
    // Entry i is for i + 1 children.
    int shares[TREE_WIDTH];
#pragma unroll
    for (int i = 1; i < most; i++) {
        costs[i] = INFINITY;
        shares[i] = 0;
#pragma unroll
        for (int j = 0; j < min(i, left_most); j++) {
            const float cost = left[j] + right[min(i - j, right_most) - 1];
            shares[i] = cost < costs[i] ? j + 1 : shares[i];
            costs[i] = smaller(cost, costs[i]);
        }
    }

    // As one child: a wide node with the cheapest number of children, or a block.
    const float node_cost = costs[most - 1] + area;
    const bool becomes_block = block_cost <= node_cost;
    costs[0] = becomes_block ? block_cost : node_cost;
    uint packed = becomes_block ? 0 : (uint)shares[most - 1];
#pragma unroll
    for (int i = 1; i < most; i++) {
        const bool is_cheaper = costs[i] < costs[i - 1];
        packed |= (is_cheaper ? (uint)shares[i] : 0) << 4 * i;
        costs[i] = is_cheaper ? costs[i] : costs[i - 1];
    }
    return packed;
}
