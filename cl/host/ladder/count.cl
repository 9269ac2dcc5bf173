// The work of the report's builders, counted while they build, for clbvh/study/ladder_work.py.

// keep: each move and comparison is counted
#define COUNTED 1
#include "ladder/subtrees.cl"

// Builds the tree of a mesh, and adds its work to `counts`, the fields of `LadderWork`.
//
// is_cached           whether boxes and centroids are computed once, into `boxes` and `centroids`
// rows                of the flat tree; null where nodes are linked ones from the heap
// prim_ids            all primitives in ascending order
// scratch, heap_count overwritten
loop void count_work(
    const long vertex_count, const float vertices[vertex_count][3], const long prim_count,
    const int faces[prim_count][3], const int how, const int buckets, const int leaf_size, const bool copies,
    const bool is_cached, box_row_t boxes[prim_count], float centroids[prim_count][3], float *rows,
    int prim_ids[prim_count], int scratch[prim_count], long heap_count[1], long counts[5])
{
    work_t *work = (work_t *)counts;
    const prims_t mesh = {vertices, faces, 0, 0, work};
    const prims_t cached = {0, 0, boxes, centroids, work};
    if (is_cached) {
        cache_metadata(&mesh, 0, prim_count, boxes, centroids);
    }
    const builder_t builder = {
        is_cached ? cached : mesh, {how, buckets, leaf_size, copies}, prim_ids, scratch, {0, heap_count},
    };
    if (rows) {
        build_flat(&builder, 0, prim_count, 0, (row_node_t *)rows, 0, 1);
    } else {
        linked_node_t *root = build_linked(&builder, prim_ids, prim_count, 0, 0);
        if (root) {
            free_nodes(root);
        }
    }
}
