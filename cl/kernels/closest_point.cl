// The face that is nearest to each point.
//
// nodes[node_count], groups[group_count]         the tree, see clbvh/layout.py
// points[3 * point_count]                        object units, relative to the mesh's origin
// prim_ids[point_count]                          written; NO_PRIM if all triangles are degenerate
// scale                                          a power of two that makes the mesh about as large as 1

#include "nearest.cl"

kernel void closest_point(
    const global node_t *restrict nodes, const global group_t *restrict groups, const int group_count,
    const global float *restrict points, global int *restrict prim_ids, const int point_count, const float scale)
{
    const int point = get_global_id(0);
    if (point >= point_count) {
        return;
    }
    nearest_t nearest = begin_nearest(scale * vload3(point, points), scale);
    visit_nearest(nodes, groups, group_count, &nearest);
    prim_ids[point] = nearest.prim_id;
}
