// Nearest triangle without a tree.

#include "nearest_search.cl"
#include "traverse_brute.cl"

void visit_nearest(
    const global node_t *nodes, const global group_t *groups, const int group_count, nearest_t *nearest)
{
    for (int place = 0; place < group_count; place++) {
        const corners_t corners = corners_at(groups, place);
        note_triangle(nearest, &corners, groups[place].prim_id);
    }
}
