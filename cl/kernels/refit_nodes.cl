// Writes the nodes of a level again, around primitives that have moved: the boxes of the children, and the same links.
// One work-item may also write several levels, one after the other.
//
// TREE_WIDTH: children of a node, of the layouts `bvh2`, `bvh4` and `bvh8`.
//
// order[]        nodes, level by level; the level is order[begin] to order[end - 1], all levels below being written
// links, nodes   the nodes of the tree, from first_link and first_node on: as they were, and as they are written
// block_boxes[]  of each block
// node_boxes[]   of each node, and the sum of half the areas of its children, those of leaves for each block; written

#ifndef TREE_WIDTH
#define TREE_WIDTH 2
#endif

#include "structs.cl"
#include "tree/boxes.cl"

#if TREE_WIDTH == 2
typedef bvh2_node_t tree_node_t;
#elif TREE_WIDTH == 4
typedef bvh4_node_t tree_node_t;
#else
typedef bvh8_node_t tree_node_t;
#endif

INLINED void refit_node(
    const int number, const global tree_node_t *links, global tree_node_t *nodes, const global float *block_boxes,
    global float *node_boxes)
{
    const global tree_node_t *before = links + number;
    global tree_node_t *node = nodes + number;
    box_t around_all = empty_box();
    float area = 0.0f;
    for (int i = 0; i < TREE_WIDTH; i++) {
        box_t box = empty_box();
#if TREE_WIDTH == 2
        const int first = before->first[i];
        const int count = before->count[i];
        const bool is_missing = before->aabb_min[i][0] > before->aabb_max[i][0];
        if (!is_missing && count > 0) {
            for (int block = first; block < first + count; block++) {
                box = unite(load_box(block_boxes, block), box);
            }
        } else if (!is_missing) {
            box = load_box(node_boxes, first);
        }
        const float cost = (float)max(count, 1);
        node->first[i] = first;
        node->count[i] = count;
        node->aabb_min[i][0] = box.lower.x;
        node->aabb_min[i][1] = box.lower.y;
        node->aabb_min[i][2] = box.lower.z;
        node->aabb_max[i][0] = box.upper.x;
        node->aabb_max[i][1] = box.upper.y;
        node->aabb_max[i][2] = box.upper.z;
#else
        const int child = before->child[i];
        const bool is_missing = before->aabb_min[0][i] > before->aabb_max[0][i];
        if (!is_missing) {
            box = child < 0 ? load_box(block_boxes, ~child) : load_box(node_boxes, child);
        }
        const float cost = 1.0f;
        node->child[i] = child;
        node->aabb_min[0][i] = box.lower.x;
        node->aabb_min[1][i] = box.lower.y;
        node->aabb_min[2][i] = box.lower.z;
        node->aabb_max[0][i] = box.upper.x;
        node->aabb_max[1][i] = box.upper.y;
        node->aabb_max[2][i] = box.upper.z;
#endif
        around_all = unite(box, around_all);
        area += is_missing ? 0.0f : box_area(box) * cost;
    }
    store_box(node_boxes, number, around_all, area);
}

kernel void refit_nodes(
    const global int *order, const int begin, const int end, const global tree_node_t *links, const int first_link,
    global tree_node_t *nodes, const int first_node, const global float *block_boxes, global float *node_boxes)
{
    for (int place = begin + (int)get_global_id(0); place < end; place += (int)get_global_size(0)) {
        refit_node(order[place], links + first_link, nodes + first_node, block_boxes, node_boxes);
    }
}
