// Builds a tree over primitives in the order of a curve: pass by pass, tiles of clusters merge until one is left, and
// then the nodes are placed, pass by pass from the root.
//
// TREE_WIDTH: children of a node, of the layouts `bvh2`, `bvh4` and `bvh8`. AS_ROWS as 1: nodes as `Bvh` has them.
// GROUPED, GROUP_SIZE: see tree/tile.cl.
//
// points, corners, pairs       see tree/prims.cl
// merges, choices, is_node, placements
//                              see tree/merges.cl
// cluster_count, tile_count, target, first_merge, levels_above
//                              of a pass, see tree/tile.cl

#ifndef TREE_WIDTH
#define TREE_WIDTH 2
#endif
#ifndef AS_ROWS
#define AS_ROWS 0
#endif
#ifndef GROUPED
#define GROUPED 0
#endif
#ifndef GROUP_SIZE
#define GROUP_SIZE 1
#endif

#include "tree/morton.cl"
#include "tree/place.cl"

#define TREE_ARGUMENTS \
    const global float *points, const global int *corners, const global ulong *pairs, global merge_t *merges, \
    global choice_t *choices, global uchar *is_node, global placement_t *placements, const int leaf_size, \
    const float traversal_cost, const float block_price

#define PASS_ARGUMENTS \
    const int cluster_count, const int tile_count, const int target, const int first_merge, const int levels_above

#define MAKE_TREE \
    const tree_t tree = { \
        {points, corners, pairs}, merges, choices, is_node, placements, leaf_size, traversal_cost, block_price}

// Write the pair of each primitive: its key, or with `is_fine` its finer one, and its number. The primitives come in
// their own order; with `is_second` in that of the pairs, which a first sort has put into the order of the finer keys.
kernel void make_keys(
    const global float *points, const global int *corners, global ulong *pairs, const int prim_count, const int is_fine,
    const int is_second)
{
    const int place = (int)get_global_id(0);
    if (place >= prim_count) {
        return;
    }
    const int prim = is_second ? (int)(uint)pairs[place] : place;
    const uint key = morton_key(box_of_prim(points, corners, prim), is_fine);
    pairs[place] = (ulong)key << 32 | (uint)prim;
}

// Merge the clusters of all tiles. In the first pass, `is_first`, they are the primitives.
kernel void merge_tiles(
    TREE_ARGUMENTS, PASS_ARGUMENTS, const global int *clusters, global int *left_over, const int is_first)
{
    MAKE_TREE;
    const global int *given = is_first ? 0 : clusters;
#if GROUPED
    local tile_memory_t memory;
    const int tile = (int)get_group_id(0);
    const tile_range_t range = find_tile(tile, cluster_count, tile_count, target, first_merge, levels_above);
    merge_tile(&tree, &range, given, left_over, tile, &memory);
#else
    const int tile = (int)get_global_id(0);
    if (tile >= tile_count) {
        return;
    }
    const tile_range_t range = find_tile(tile, cluster_count, tile_count, target, first_merge, levels_above);
    merge_tile(&tree, &range, given, left_over, tile);
#endif
}

// The numbers of a tile's merges, of which later ones lie above earlier ones.
INLINED int2 find_merges(const int tile, PASS_ARGUMENTS)
{
    if (tile >= tile_count) {
        return (int2)(0);
    }
    const tile_range_t range = find_tile(tile, cluster_count, tile_count, target, first_merge, levels_above);
    return (int2)(range.first_merge, range.first_merge + range.count - range.target);
}

#define MERGES_OF_TILE \
    find_merges((int)get_global_id(0), cluster_count, tile_count, target, first_merge, levels_above)

// Of wide trees, as the next kernel.
kernel void mark_root(TREE_ARGUMENTS, const int root)
{
#if TREE_WIDTH > 2
    MAKE_TREE;
    if (!is_block(&tree, root)) {
        tree.is_node[root] = 1;
    }
#endif
}

// Mark the merges of a pass that become wide nodes, those of later passes being marked; count what is below the nodes
// of a pass, those of earlier passes being counted. The first pass does both while its merges are in the cache.
kernel void visit_tiles(TREE_ARGUMENTS, PASS_ARGUMENTS, const int marks, const int counts)
{
#if TREE_WIDTH > 2
    MAKE_TREE;
    const int2 range = MERGES_OF_TILE;
    if (marks) {
        for (int number = range.y - 1; number >= range.x; number--) {
            if (tree.is_node[number]) {
                mark_children(&tree, number);
            }
        }
    }
    if (counts) {
        for (int number = range.x; number < range.y; number++) {
            if (tree.is_node[number]) {
                count_subtree(&tree, number);
            }
        }
    }
#endif
}

// Write what the host must know before it has room for the nodes; `root` is the last cluster.
kernel void summarize(TREE_ARGUMENTS, const int root, global tree_summary_t *summary)
{
    MAKE_TREE;
    const box_t box = box_of_cluster(&tree, root);
    summary->aabb_min[0] = box.lower.x;
    summary->aabb_min[1] = box.lower.y;
    summary->aabb_min[2] = box.lower.z;
    summary->aabb_max[0] = box.upper.x;
    summary->aabb_max[1] = box.upper.y;
    summary->aabb_max[2] = box.upper.z;
    summary->stack_size = 0;
#if TREE_WIDTH == 2
    summary->node_count = interior_count_of(&tree, root);
    summary->block_count = prim_count_of(&tree, root);
#else
    summary->node_count = is_block(&tree, root) ? 1 : placements[root].next_node;
    summary->block_count = is_block(&tree, root) ? 1 : placements[root].next_block;
#endif
}

// The arguments of the tree's arrays; nodes have the struct of the layout.
#define OUTPUT_ARGUMENTS global void *nodes, global int *prims, global tree_summary_t *summary

kernel void place_first(TREE_ARGUMENTS, OUTPUT_ARGUMENTS, const int root)
{
    MAKE_TREE;
    const output_t output = {nodes, prims, summary};
    place_root(&tree, &output, root);
}

// Place the nodes of a pass, those of later passes being placed.
kernel void place_tiles(TREE_ARGUMENTS, PASS_ARGUMENTS, OUTPUT_ARGUMENTS)
{
    MAKE_TREE;
    const output_t output = {nodes, prims, summary};
    const int2 range = MERGES_OF_TILE;
    for (int number = range.y - 1; number >= range.x; number--) {
        if (tree.is_node[number]) {
            place_node(&tree, &output, number);
        }
    }
}
