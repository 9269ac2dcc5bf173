// A point, and the nearest primitive found so far.
//
// In local coordinates the mesh is about as large as 1, so that no product leaves float32. Triangles are translated so
// that the point is zero. Corners and edges shared by two triangles then have the same coordinates in both, hence the
// same distance, bit for bit; of equally near triangles the smaller prim_id wins, so the order of the tests does not
// matter.
//
// HAS_SPHERES, if defined as 1: the primitives may be spheres, and `kind` says whether they are. make_nearest leaves it
// at triangles.
//
// LONE, see world/world.cl, defined as 0: the tree is that of an instance, and distances are those of the world, see
// nearest/metric.cl.

#include "structs.cl"
#include "math/vectors.cl"
#if !LONE
#include "nearest/metric.cl"
#endif

// Bound on the error of a computed distance, relative to the farthest corner: one rounding of the difference to the
// point, seven of the weighted sum of corners, three of its length, and those of the box's distance.
//
// The distance of a sphere has ten roundings relative to the farthest corner of its box, six of them those of a square
// root by OpenCL's bound; the root of its square has seven more, the box's distance three, and the comparison two.
#if HAS_SPHERES
#define NEAREST_ROUNDINGS 22
#else
#define NEAREST_ROUNDINGS 16
#endif
#define NEAREST_SLACK ERROR_BOUND(NEAREST_ROUNDINGS)

typedef struct {
#if !LONE
    metric_t metric;
#else
    float3 point;
#endif
    float distance_squared;
    float distance;
    int prim_id;
#if HAS_SPHERES
    int kind;  // KIND_TRIANGLES or KIND_SPHERES: the primitives of the tree that is traversed
#endif
} nearest_t;

#if LONE
INLINED nearest_t make_nearest(const float3 point)
{
    const nearest_t nearest = {point, INFINITY, INFINITY, NO_PRIM};
    return nearest;
}
#endif

// Whether a primitive in a box may be as near as the nearest so far; *distance_squared is that of the box.
#if LONE
INLINED bool may_be_nearer(
    const nearest_t *nearest, const float3 aabb_min, const float3 aabb_max, float *distance_squared)
{
    const float3 below = aabb_min - nearest->point;
    const float3 above = aabb_max - nearest->point;
    const float3 outside = fmax(fmax(below, -above), 0.0f);
    const float3 farthest = fmax(fabs(below), fabs(above));
    *distance_squared = dot_product(outside, outside);
    const float limit = nearest->distance + NEAREST_SLACK * (farthest.x + farthest.y + farthest.z);
    return *distance_squared <= limit * limit;
}
#elif !defined(WIDTH)
INLINED bool may_be_nearer(
    const nearest_t *nearest, const float3 aabb_min, const float3 aabb_max, float *distance_squared)
{
    const point_t lower = {aabb_min.x, aabb_min.y, aabb_min.z};
    const point_t upper = {aabb_max.x, aabb_max.y, aabb_max.z};
    const point_t way = way_to_box(&nearest->metric, lower, upper);
    *distance_squared = dot_of(way, way);
    const float limit = nearest->distance + nearest->metric.slack;
    return *distance_squared <= limit * limit;
}
#endif

// Takes a primitive's squared distance into account.
INLINED void add_distance(nearest_t *nearest, const float distance_squared, const int prim_id)
{
    const bool wins_tie = prim_id < nearest->prim_id || nearest->prim_id == NO_PRIM;
    if (distance_squared < nearest->distance_squared
        || (distance_squared == nearest->distance_squared && wins_tie)) {
        nearest->distance_squared = distance_squared;
        nearest->distance = sqrt(distance_squared);
        nearest->prim_id = prim_id;
    }
}
