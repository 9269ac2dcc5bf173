// Nearest triangle without a tree.

#include "nearest_one.cl"
#include "traverse_brute.cl"

INLINED void visit_nearest(
    const global node_t *nodes, const global group_t *groups, const int group_count, nearest_t *nearest)
{
    for (int place = 0; place < group_count; place++) {
        note_triangle(nearest, groups, place);
    }
}
