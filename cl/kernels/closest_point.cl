// The nearest triangle of each point; of equally near ones the smallest prim_id.
//
// nodes[node_count]           node_t: the tree in its layout, see clbvh/structs.py
// blocks[block_count]         block_t: triangles in leaf order, local coordinates
// points[3 * point_count]     float: local coordinates
// prim_ids[point_count]       written: NO_PRIM if all triangles are degenerate
//
// Work-items: (point_count), rounded up to whole work-groups.

#include "nearest/nearest.cl"
#include "world/world.cl"

kernel void closest_point(
    WORLD_ARGUMENTS, const global float *restrict points, global int *restrict prim_ids, const int point_count)
{
    const int point = get_global_id(0);
    if (point >= point_count) {
        return;
    }
    nearest_t nearest = make_nearest(vload3(point, points));
    find_nearest(nodes, blocks, block_count, &nearest);
    prim_ids[point] = nearest.prim_id;
}
