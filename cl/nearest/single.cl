// A triangle on its own, in the layouts whose groups are one triangle.

#include "nearest_search.cl"
#include "one_triangle.cl"

INLINED point_t corner_seen(const nearest_t *nearest, const float3 corner)
{
    const float3 moved = nearest->scale * corner - nearest->point;
    const point_t result = {moved.x, moved.y, moved.z};
    return result;
}

INLINED void note_triangle(nearest_t *nearest, const global group_t *groups, const int place)
{
    const corners_t corners = corners_at(groups, place);
    // A degenerate triangle is stored with three equal corners, and is nobody's nearest.
    if (all(corners.a == corners.b) && all(corners.a == corners.c)) {
        return;
    }
    const float squared = distance_squared_to_triangle(
        corner_seen(nearest, corners.a), corner_seen(nearest, corners.b), corner_seen(nearest, corners.c));
    note_distance(nearest, squared, groups[place].prim_id);
}
