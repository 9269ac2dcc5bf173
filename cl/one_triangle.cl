// Groups of one triangle, which is tested on its own.

#include "triangle.cl"

typedef triangle_t group_t;

INLINED corners_t corners_at(const global group_t *groups, const int place)
{
    const global triangle_t *triangle = groups + place;
    const corners_t corners = {load3(triangle->a), load3(triangle->b), load3(triangle->c)};
    return corners;
}

INLINED void intersect_triangle(
    const global group_t *groups, const int place, const path_t *path, search_t *search, const int query)
{
    const corners_t corners = corners_at(groups, place);
    intersect_corners(&corners, groups[place].prim_id, place, path, search, query);
}
