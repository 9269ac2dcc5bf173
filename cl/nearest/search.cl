// A point, and the triangle nearest to it so far.
//
// All lengths are scaled, so that the mesh is about as large as 1 and no product leaves float32. A triangle is moved by
// the point first: what two triangles share is the same number for both, and they are equally far away where an edge or
// a corner of both is nearest. Then the smaller face number wins, whatever the order of the visits.

#include "numeric.cl"
#include "point_triangle.cl"

// How far the distance that is computed may be below the true one, relative to the triangle's farthest corner: one
// rounding of the difference to the point, seven of the weighted sum of corners, three of its length, and as many of the
// box's distance.
#define NEAREST_SLACK ERROR_BOUND(16)

typedef struct {
    float3 point;
    float scale;
    float distance_squared;
    float distance;
    int prim_id;
} nearest_t;

INLINED nearest_t begin_nearest(const float3 point, const float scale)
{
    const nearest_t nearest = {point, scale, INFINITY, INFINITY, NO_PRIM};
    return nearest;
}

// Whether something in a box may be as near as the nearest so far; *entry is the square of the box's distance.
INLINED bool may_be_nearer(const nearest_t *nearest, const float3 aabb_min, const float3 aabb_max, float *entry)
{
    const float3 below = nearest->scale * aabb_min - nearest->point;
    const float3 above = nearest->scale * aabb_max - nearest->point;
    const float3 outside = fmax(fmax(below, -above), 0.0f);
    const float3 farthest = fmax(fabs(below), fabs(above));
    *entry = dot(outside, outside);
    const float limit = nearest->distance + NEAREST_SLACK * (farthest.x + farthest.y + farthest.z);
    return *entry <= limit * limit;
}

INLINED void note_distance(nearest_t *nearest, const float squared, const int prim_id)
{
    if (squared < nearest->distance_squared
        || (squared == nearest->distance_squared && (prim_id < nearest->prim_id || nearest->prim_id == NO_PRIM))) {
        nearest->distance_squared = squared;
        nearest->distance = sqrt(squared);
        nearest->prim_id = prim_id;
    }
}
