// The builders of the report, for clbvh/builders/ladder/steps.py, and the arrays of its tasks:
//
// vertices, faces     the mesh; null in builders that cached its metadata
// boxes, centroids    this metadata; null in the others
// blocks, counter     nodes of a builder with an atomic counter; `blocks` is null where they come from the heap
// scratch             as long as the task's range

#include "ladder/subtrees.cl"

static prims_t prims_of(const float *vertices, const int *faces, const float *boxes, const float *centroids)
{
    return (prims_t){
        (const float (*)[3])vertices, (const int (*)[3])faces, (const box_row_t *)boxes, (const float (*)[3])centroids,
    };
}

// Computes the boxes and the centroids of a slice of the primitives.
loop void cache_slice(
    const long vertex_count, const float vertices[vertex_count][3], const long count, const int faces[count][3],
    const long begin, const long end, box_row_t boxes[count], float centroids[count][3])
{
    const prims_t mesh = {vertices, faces};
    cache_metadata(&mesh, begin, end, boxes, centroids);
}

// Divides a range of the top, and writes its box; returns how many primitives are on the left.
loop long divide_range(
    const float *vertices, const int *faces, const float *boxes, const float *centroids, const int how,
    const int buckets, const int leaf_size, const bool copies, const long count, int ids[count], const int depth,
    int scratch[count], box_row_t box[1])
{
    const prims_t prims = prims_of(vertices, faces, boxes, centroids);
    const rule_t rule = {how, buckets, leaf_size, copies};
    const bounds_t bounds = bound_range(&prims, ids, count);
    box[0] = bounds.box;
    return divide(&prims, ids, count, depth, &rule, &bounds, scratch);
}

// Writes references to new nodes of the blocks.
loop void allocate_blocks(long *blocks, long *counter, const long count, long references[count])
{
    const heap_t heap = {(linked_node_t *)blocks, counter};
    for (long index = 0; index < count; index++) {
        references[index] = reference_to(heap.blocks, allocate_node(&heap));
    }
}

// Builds a subtree of linked nodes, from a range of the index array or from a list of its own, and counts nodes of the
// heap. Returns the reference to its root; -1 if there is no memory.
loop long build_linked_subtree(
    const float *vertices, const int *faces, const float *boxes, const float *centroids, const int how,
    const int buckets, const int leaf_size, const bool copies, const long count, int ids[count], const long first,
    const int depth, int *prim_ids, int scratch[count], long *blocks, long *counter)
{
    const builder_t builder = {
        prims_of(vertices, faces, boxes, centroids), {how, buckets, leaf_size, copies}, prim_ids, scratch,
        {(linked_node_t *)blocks, counter},
    };
    const linked_node_t *root = build_linked(&builder, ids, count, first, depth);
    return root ? reference_to(builder.heap.blocks, root) : -1;
}

// Writes a linked tree to its place in the flat one, see `Placement` of clbvh/builders/invariants.py.
loop void flatten_subtree(
    const long *blocks, const long root, const long count, box_row_t nodes[count], const long index, const long below)
{
    flatten((const linked_node_t *)blocks, root, (row_node_t *)nodes, index, below);
}

loop void free_subtree(const long root)
{
    free_nodes(node_of(0, root));
}

// Builds a subtree flat, from row 2 * first on; returns how many nodes it has. A tree over n primitives has at most
// 2n - 1 nodes, so ranges that do not overlap own rows that do not overlap.
loop long build_flat_subtree(
    const float *vertices, const int *faces, const float *boxes, const float *centroids, const int how,
    const int buckets, const int leaf_size, const bool copies, const long prim_count, int prim_ids[prim_count],
    const long first, const int depth, const long count, int scratch[count], box_row_t rows[2 * prim_count])
{
    const builder_t builder = {
        prims_of(vertices, faces, boxes, centroids), {how, buckets, leaf_size, copies}, prim_ids, scratch,
    };
    const long root = 2 * first;
    return build_flat(&builder, first, count, depth, (row_node_t *)rows, root, root + 1) - root;
}
