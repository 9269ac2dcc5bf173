// A point, and the nearest primitives found so far: one, or as many as a heap has room for.
//
// In local coordinates a shape is about as large as 1, so that no product leaves float32. Triangles are translated so
// that the point is zero. Corners and edges shared by two triangles then have the same coordinates in both, hence the
// same distance, bit for bit; of equally near triangles the smaller prim_id wins, so the order of the tests does not
// matter.
//
// Whether there is a heap is a constant wherever these functions are called, so inlining removes the code of the other.

// keep: defines LONE
#include "structs.cl"
#include "hits/search.cl"
#include "math/vectors.cl"
#include "nearest/metric.cl"

#if FINE_BOUNDS

INLINED real_t sizes_of(const real_t numbers)
{
    return LARGER(numbers, -numbers);
}

// The largest coordinate of three corners.
INLINED real_t farthest_of(const point_t a, const point_t b, const point_t c)
{
    const real_t x = LARGER(LARGER(sizes_of(a.x), sizes_of(b.x)), sizes_of(c.x));
    const real_t y = LARGER(LARGER(sizes_of(a.y), sizes_of(b.y)), sizes_of(c.y));
    const real_t z = LARGER(LARGER(sizes_of(a.z), sizes_of(b.z)), sizes_of(c.z));
    return LARGER(LARGER(x, y), z);
}

#endif

// The nearest primitives in global memory. They are kept as hits, whose t is a lower bound on the distance, in the
// world's local coordinates, less all that rounding can do. So none that is left out is nearer than the farthest t.
typedef struct {
    global kept_hit_t *heap;  // [room]: binary heap with the farthest on top; NULL: only the nearest one is wanted
    int room;
    int count;
    bool is_single;           // only the nearest one of them is wanted
    float limit;              // it is surely not farther
} near_heap_t;

typedef struct {
    metric_t metric;
    float distance_squared;
    float distance;
    int prim_id;
    int kind;                 // of the primitives of the tree that is traversed
    bool is_of_inside;        // solids are at distance zero from the points inside, and not near any others
    bool is_of_box;           // the distance is that of the boxes around primitives from a box
    near_heap_t kept;
    int instance_id;
} nearest_t;

INLINED near_heap_t no_heap(void)
{
    const near_heap_t none = {0, 0, 0, false, INFINITY};
    return none;
}

// With fine bounds, box distances may be above those of their triangles by this share.
#if FINE_BOUNDS
#define BOX_GROWTH (1.0f + ERROR_BOUND(64))
#else
#define BOX_GROWTH 1.0f
#endif

// How far a triangle's distance may be above what it is compared with.
INLINED float slack_of_kept(const metric_t *metric)
{
#if FINE_BOUNDS
    return 0.0f;
#else
    return metric->slack;
#endif
}

// The squared distance of the box around a triangle from a box. NaN stays NaN, which minima and maxima may lose.
INLINED real_t way_squared_to_triangle(const metric_t *metric, const point_t a, const point_t b, const point_t c)
{
    const point_t lower = {
        SMALLER(SMALLER(a.x, b.x), c.x), SMALLER(SMALLER(a.y, b.y), c.y), SMALLER(SMALLER(a.z, b.z), c.z)};
    const point_t upper = {
        LARGER(LARGER(a.x, b.x), c.x), LARGER(LARGER(a.y, b.y), c.y), LARGER(LARGER(a.z, b.z), c.z)};
    const point_t way = way_from(lower, upper, metric->half_sides);
    return dot_of(way, way) + (a.x - a.x);
}

// The squared distance of a triangle by which it is kept, from the point or from a box; with fine bounds a lower bound
// on it, and *upper an upper bound on the distance. NaN stays NaN.
INLINED real_t
squared_to_triangle(const nearest_t *nearest, const point_t a, const point_t b, const point_t c, real_t *upper)
{
    const metric_t *metric = &nearest->metric;
    const real_t squared =
        nearest->is_of_box ? way_squared_to_triangle(metric, a, b, c) : distance_squared_to_triangle(a, b, c);
#if FINE_BOUNDS
    const real_t error = ERROR_BOUND(64) * farthest_of(a, b, c) + metric->slack;
    const real_t distance = sqrt(squared);
    const real_t lower = LARGER((real_t)(0.0f), distance - error);
    *upper = distance + error;
    return lower * lower;
#else
    *upper = (real_t)(INFINITY);
    return squared;
#endif
}

// A primitive as it is kept.
INLINED kept_hit_t as_kept(const float bound, const int prim_id, const int instance_id)
{
#if LONE
    const kept_hit_t kept = {bound, 0.0f, 0.0f, prim_id};
#else
    const kept_hit_t kept = {bound, 0.0f, 0.0f, prim_id, instance_id, 0.0f};
#endif
    return kept;
}

// How far the farthest is of those in a heap, and all that are left out; INFINITY while there is room.
INLINED float farthest_kept(const near_heap_t *kept)
{
    return smaller(kept->count < kept->room ? INFINITY : larger(kept->heap[0].t, 0.0f), kept->limit);
}

// A search in one shape.
INLINED nearest_t make_nearest(const metric_t metric, const int kind)
{
    nearest_t nearest;
    nearest.metric = metric;
    nearest.distance_squared = nearest.distance = INFINITY;
    nearest.prim_id = NO_PRIM;
    nearest.kind = kind;
    nearest.is_of_inside = nearest.is_of_box = false;
    nearest.kept = no_heap();
    nearest.instance_id = 0;
    return nearest;
}

// The length of a unit of the metric in the world's local coordinates.
INLINED float unit_length(const metric_t *metric)
{
#if LONE
    return 1.0f;
#else
    return 1.0f / metric->unit;
#endif
}

// Rounded up: what is too far loses later.
#define ROUNDED_UP (1.0f + ERROR_BOUND(8))

// Looks for nothing that is farther than a distance in the world's local coordinates; or, with a heap, that is surely
// farther.
INLINED void limit_distance(nearest_t *nearest, const float distance)
{
    nearest->distance = distance / unit_length(&nearest->metric) * ROUNDED_UP;
    const float most = nearest->distance + (nearest->kept.heap ? slack_of_kept(&nearest->metric) * ROUNDED_UP : 0.0f);
    nearest->distance_squared = most * most + FLT_MIN;
}

// Adds to a limit in the point's own distance what rounding may add to that of a primitive.
INLINED void grow_limit(nearest_t *nearest)
{
    nearest->distance = (nearest->distance + nearest->metric.slack) * BOX_GROWTH;
    nearest->distance_squared = nearest->distance * nearest->distance + FLT_MIN;
}

// Whether a primitive in a box may be as near as the nearest so far; *distance_squared is that of the box.
#ifndef WIDTH
INLINED bool may_be_nearer(
    const nearest_t *nearest, const float3 aabb_min, const float3 aabb_max, float *distance_squared)
{
    const point_t lower = {aabb_min.x, aabb_min.y, aabb_min.z};
    const point_t upper = {aabb_max.x, aabb_max.y, aabb_max.z};
    const point_t way = way_to_box(&nearest->metric, lower, upper);
    *distance_squared = dot_of(way, way);
    const float limit = (nearest->distance + nearest->metric.slack) * BOX_GROWTH;
    return *distance_squared <= limit * limit;
}
#endif

INLINED void
keep_primitive(nearest_t *nearest, const float distance_squared, const float upper, const int prim_id)
{
    near_heap_t *kept = &nearest->kept;
    if (kept->is_single) {
        kept->limit = smaller(upper, kept->limit);
    }
    const float bound = (sqrt(distance_squared) - slack_of_kept(&nearest->metric)) * unit_length(&nearest->metric);
    kept->count = keep_first(kept->heap, kept->count, kept->room, as_kept(bound, prim_id, nearest->instance_id));
    limit_distance(nearest, farthest_kept(kept));
}

// Takes a primitive's squared distance into account; `upper` is an upper bound on the distance, or INFINITY.
INLINED void add_distance(nearest_t *nearest, const float distance_squared, const float upper, const int prim_id)
{
    if (nearest->kept.heap) {
        keep_primitive(nearest, distance_squared, upper, prim_id);
        return;
    }
    const bool wins_tie = prim_id < nearest->prim_id || nearest->prim_id == NO_PRIM;
    if (distance_squared < nearest->distance_squared
        || (distance_squared == nearest->distance_squared && wins_tie)) {
        nearest->distance_squared = distance_squared;
        nearest->distance = sqrt(distance_squared);
        nearest->prim_id = prim_id;
    }
}
