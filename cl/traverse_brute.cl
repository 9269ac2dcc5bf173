// No tree: every triangle against every ray. The study's baseline, for small meshes.

#include "one_triangle.cl"

// Not used.
typedef bvh2_node_t node_t;

INLINED void traverse(
    const global node_t *nodes, const global node_t *start, const global group_t *groups, const int group_count,
    const path_t *path, search_t *search, const int query)
{
    for (int place = 0; place < group_count && !is_settled(search, query); place++) {
        intersect_triangle(groups, place, path, search, query);
    }
}
