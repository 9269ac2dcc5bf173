// A shape as seen from a point, which is at zero.
//
// The slack of a metric is a bound on the error of a primitive's distance minus that of its box. No coordinate within a
// shape is above 1. The distance of a triangle has 16 roundings relative to the farthest corner: one of the difference
// to the point, seven of the weighted sum of corners, three of its length, and those of the box's distance. That of a
// sphere has ten, six of them those of a square root by OpenCL's bound; the root of its square has seven more, and the
// box's distance three. A limit on the box's distance has four, and a lower bound of the distance three.
//
// LONE, see world/world.cl, as 0: the shape is that of an instance. Distances within it are those of the world: corners
// are moved into the world, with the point at zero. A box becomes a parallelepiped there. It is measured in rotated
// axes, in which the map is triangular (METRIC in clbvh/structs.py), by the box around it. That box is the
// parallelepiped itself if the map scales along the local axes and rotates then; for any map, the two differ by no more
// than their own size. Lengths are in units of the metric: the power of two that brings the way to the instance, or its
// radius, to about 1, so that no product leaves float32, however small the instance is. The slack has room for the
// roundings of the rotated axes, and for a shear that is left out, which counts as 8.

// EXACT, of a lone mesh: its parts may be far smaller than it is. The slack is then relative to the point alone, and
// the rest is relative to the distance of a box, or to the farthest corner of a triangle: FINE_BOUNDS.

// keep: defines LONE, and is expanded before the branches
#include "structs.cl"
#include "math/vectors.cl"
#include "nearest/point_triangle.cl"
#include "instances/instance.cl"

#define FINE_BOUNDS (EXACT && LONE && HAS_TRIANGLES)

// How far a box is from zero along each axis, or from a box around zero.
INLINED point_t way_from(const point_t lower, const point_t upper, const float3 half_sides)
{
    const real_t zero = (real_t)(0.0f);
    const point_t way = {
        LARGER(LARGER(lower.x, -upper.x) - half_sides.x, zero), LARGER(LARGER(lower.y, -upper.y) - half_sides.y, zero),
        LARGER(LARGER(lower.z, -upper.z) - half_sides.z, zero)};
    return way;
}

#define LONE_SLACK ERROR_BOUND(32)
#define METRIC_SLACK ERROR_BOUND(64)

INLINED float sum_of(const float3 v)
{
    return v.x + v.y + v.z;
}

#if LONE

typedef struct {
    float3 point;
    float slack;
    float3 half_sides;  // of a box around the point, or 0
} metric_t;

// The metric of a lone shape for a point, or for a box around it, in its local coordinates.
INLINED metric_t make_lone_metric(const float3 point, const float3 half_sides)
{
#if FINE_BOUNDS
    const metric_t metric = {point, 2.0f * LONE_SLACK * sum_of(magnitude(point)), half_sides};
#else
    const metric_t metric = {point, LONE_SLACK * (sum_of(magnitude(point)) + 3.0f), half_sides};
#endif
    return metric;
}

// A point of the shape, relative to the point. A corner that two triangles share has the same bits in both.
INLINED point_t place_point(const metric_t *metric, const real_t x, const real_t y, const real_t z)
{
    const point_t result = {x - metric->point.x, y - metric->point.y, z - metric->point.z};
    return result;
}

// How far a box is from the point, along each axis; 0 where the point is within.
INLINED point_t way_to_box(const metric_t *metric, const point_t aabb_min, const point_t aabb_max)
{
    const point_t lower = place_point(metric, aabb_min.x, aabb_min.y, aabb_min.z);
    const point_t upper = place_point(metric, aabb_max.x, aabb_max.y, aabb_max.z);
    return way_from(lower, upper, metric->half_sides);
}

#else

typedef struct {
    float to_world[3][3];  // from the geometry's local coordinates into the scene, by rows
    float3 offset;         // from the point to the zero of the geometry's local coordinates
    float unit;            // units of the metric in one of the scene's
    // The same map in rotated axes.
    float3 stretch;  // the diagonal of the triangular matrix
    float3 shear;    // above it: of y to x, of z to x and of z to y
    bool is_sheared;
    float3 start;  // the offset
    float slack;
    float3 half_sides;         // of a box around the point, or 0
    float3 turned_half_sides;  // of the box around that in rotated axes
    const global metric_record_t *record;
} metric_t;

// A point of the geometry in the scene, relative to the point. A corner that two triangles share has the same bits in
// both.
INLINED point_t place_point(const metric_t *metric, const real_t x, const real_t y, const real_t z)
{
    const point_t result = {
        metric->to_world[0][0] * x + metric->to_world[0][1] * y + metric->to_world[0][2] * z + metric->offset.x,
        metric->to_world[1][0] * x + metric->to_world[1][1] * y + metric->to_world[1][2] * z + metric->offset.y,
        metric->to_world[2][0] * x + metric->to_world[2][1] * y + metric->to_world[2][2] * z + metric->offset.z};
    return result;
}

INLINED void add_shear(
    const float shear, const real_t from_lower, const real_t from_upper, real_t *lower, real_t *upper)
{
    const real_t one = shear * from_lower;
    const real_t other = shear * from_upper;
    *lower += SMALLER(one, other);
    *upper += LARGER(one, other);
}

// How far a box is from the point, along each of the rotated axes; 0 where the point is within.
INLINED point_t way_to_box(const metric_t *metric, const point_t aabb_min, const point_t aabb_max)
{
    point_t lower = {
        metric->stretch.x * aabb_min.x + metric->start.x, metric->stretch.y * aabb_min.y + metric->start.y,
        metric->stretch.z * aabb_min.z + metric->start.z};
    point_t upper = {
        metric->stretch.x * aabb_max.x + metric->start.x, metric->stretch.y * aabb_max.y + metric->start.y,
        metric->stretch.z * aabb_max.z + metric->start.z};
    if (metric->is_sheared) {
        add_shear(metric->shear.x, aabb_min.y, aabb_max.y, &lower.x, &upper.x);
        add_shear(metric->shear.y, aabb_min.z, aabb_max.z, &lower.x, &upper.x);
        add_shear(metric->shear.z, aabb_min.z, aabb_max.z, &lower.y, &upper.y);
    }
    return way_from(lower, upper, metric->turned_half_sides);
}

// Makes the metric of an instance for a point or for a box around it, given the way from the point to the instance.
INLINED metric_t make_metric(
    const global instance_t *instance, const global metric_record_t *record, const float3 way, const bool is_box,
    const float3 half_sides)
{
    metric_t metric;
    const float3 size = magnitude(way);
    const float unit = unit_scale((float3)(larger(size.x, larger(size.y, size.z)), instance->radius, 0.0f));
    metric.unit = unit;
    metric.offset = unit * way;
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            metric.to_world[row][column] = unit * instance->to_world[row][column];
        }
    }
    metric.stretch = unit * load3(record->stretch);
    metric.shear = unit * load3(record->shear);
    metric.is_sheared = record->is_sheared;
    metric.start = transform_vector(record->turn, metric.offset);
    metric.slack = METRIC_SLACK * (sum_of(magnitude(metric.offset)) + unit * record->reach);
    metric.half_sides = metric.turned_half_sides = half_sides;
    if (is_box) {
        metric.half_sides = unit * half_sides;
        metric.turned_half_sides = (float3)(
            dot_product(magnitude(load3(record->turn[0])), metric.half_sides),
            dot_product(magnitude(load3(record->turn[1])), metric.half_sides),
            dot_product(magnitude(load3(record->turn[2])), metric.half_sides));
    }
    metric.record = record;
    return metric;
}

// The metric of a shape for a point, or for a box around it, in the shape's local coordinates.
INLINED metric_t make_lone_metric(const float3 point, const float3 half_sides)
{
    const metric_t metric = {
        {{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}}, -point, 1.0f, (float3)(1.0f), (float3)(0.0f),
        false, -point, METRIC_SLACK * (sum_of(magnitude(point)) + 3.0f), half_sides, half_sides, 0};
    return metric;
}

#endif
