// Distances within an instance are those of the scene: corners are moved into the scene, with the point at zero. A box
// becomes a parallelepiped there. It is measured in rotated axes, in which the map is triangular (QR decomposition), by
// the box around it. That box is the parallelepiped itself if the map scales along the local axes and rotates then; for
// any map, the two differ by no more than their own size.
//
// Lengths are in units of the metric: the power of two that brings the way to the instance, or its radius, to about 1,
// so that no product leaves float32, however small the instance is.

#include "instances/instance.cl"
#include "math/vectors.cl"
#include "nearest/point_triangle.cl"

// Columns of the map with a cosine up to this are orthogonal, and lengths that differ by this share are equal: so much
// is left of a rotation in float32.
#define ORTHOGONAL_SLACK ERROR_BOUND(4)
#define EQUAL_SLACK ERROR_BOUND(16)

// Sweeps of rotations; a sweep squares the cosines that are left.
#define SWEEPS 6

typedef struct {
    float to_scene[3][3];  // from the geometry's local coordinates into the scene, by rows
    float3 offset;         // from the point to the zero of the geometry's local coordinates
    float unit;            // units of the metric in one of the scene's
    // The same map in rotated axes.
    float3 stretch;  // the diagonal of the triangular matrix
    float3 shear;    // above it: of y to x, of z to x and of z to y
    bool is_sheared;
    float3 start;  // the offset
    float slack;   // bound on the error of a primitive's distance minus that of its box
#if HAS_SPHERES
    // The ellipsoid that the map makes of a sphere of radius 1.
    float3 axes[3];       // orthogonal unit vectors
    float3 half_lengths;  // along the axes
    bool keeps_spheres;   // whether it is a sphere
#endif
} metric_t;

// A point of the geometry in the scene, relative to the point. A corner that two triangles share has the same bits in
// both.
INLINED point_t place_point(const metric_t *metric, const real_t x, const real_t y, const real_t z)
{
    const point_t result = {
        metric->to_scene[0][0] * x + metric->to_scene[0][1] * y + metric->to_scene[0][2] * z + metric->offset.x,
        metric->to_scene[1][0] * x + metric->to_scene[1][1] * y + metric->to_scene[1][2] * z + metric->offset.y,
        metric->to_scene[2][0] * x + metric->to_scene[2][1] * y + metric->to_scene[2][2] * z + metric->offset.z};
    return result;
}

INLINED float3 load_row(const metric_t *metric, const int row)
{
    return (float3)(metric->to_scene[row][0], metric->to_scene[row][1], metric->to_scene[row][2]);
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
    const real_t zero = (real_t)(0.0f);
    const point_t way = {
        LARGER(LARGER(lower.x, -upper.x), zero), LARGER(LARGER(lower.y, -upper.y), zero),
        LARGER(LARGER(lower.z, -upper.z), zero)};
    return way;
}

INLINED float sum_of(const float3 v)
{
    return v.x + v.y + v.z;
}

// Rotates two rows, of which `a` and `b` are entries of one column, so that b becomes zero and a is not negative.
INLINED void rotate_rows(const float a, const float b, float4 *row, float4 *other)
{
    const float size = sqrt(a * a + b * b);
    if (size > 0.0f) {
        const float cosine = a / size;
        const float sine = b / size;
        const float4 rotated = cosine * *row + sine * *other;
        *other = cosine * *other - sine * *row;
        *row = rotated;
    }
}

// Finds the rotated axes (Givens, "Computation of plane unitary rotations transforming a general matrix to triangular
// form", 1958), and the slack.
INLINED void rotate_axes(metric_t *metric)
{
    float4 rows[3];
    for (int row = 0; row < 3; row++) {
        rows[row].xyz = load_row(metric, row);
    }
    rows[0].w = metric->offset.x;
    rows[1].w = metric->offset.y;
    rows[2].w = metric->offset.z;
    rotate_rows(rows[0].x, rows[1].x, rows, rows + 1);
    rotate_rows(rows[0].x, rows[2].x, rows, rows + 2);
    rotate_rows(rows[1].y, rows[2].y, rows + 1, rows + 2);
    rows[2] = rows[2].z < 0.0f ? -rows[2] : rows[2];
    metric->stretch = (float3)(rows[0].x, rows[1].y, rows[2].z);
    metric->shear = (float3)(rows[0].y, rows[0].z, rows[1].z);
    metric->start = (float3)(rows[0].w, rows[1].w, rows[2].w);

    // No coordinate within the geometry is above 1. A distance has about 16 roundings, see NEAREST_SLACK; a rotation
    // has four for each entry, and a shear that is left out counts as 8.
    float rounding = sum_of(magnitude(metric->offset));
    for (int row = 0; row < 3; row++) {
        rounding += sum_of(magnitude(load_row(metric, row)));
    }
    metric->slack = ERROR_BOUND(64) * rounding;
    const float3 shear = magnitude(metric->shear);
    metric->is_sheared = larger(shear.x, larger(shear.y, shear.z)) > ERROR_BOUND(8) * rounding;
}

#if HAS_SPHERES
// Finds the axes of the ellipsoids: the columns of the map are rotated in pairs until they are orthogonal (one-sided
// Jacobi: Hestenes, "Inversion of matrices by biorthogonalization and related results", 1958).
INLINED void find_axes(metric_t *metric)
{
    float3 columns[3];
    for (int column = 0; column < 3; column++) {
        columns[column] =
            (float3)(metric->to_scene[0][column], metric->to_scene[1][column], metric->to_scene[2][column]);
    }
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        for (int pair = 0; pair < 3; pair++) {
            const int one = pair == 2 ? 1 : 0;
            const int other = pair == 0 ? 1 : 2;
            const float3 a = columns[one];
            const float3 b = columns[other];
            const float shared = dot_product(a, b);
            const float a_squared = dot_product(a, a);
            const float b_squared = dot_product(b, b);
            if (fabs(shared) > ORTHOGONAL_SLACK * sqrt(a_squared) * sqrt(b_squared)) {
                const float cotangent = (b_squared - a_squared) / (2.0f * shared);
                const float size = fabs(cotangent) + sqrt(1.0f + cotangent * cotangent);
                const float tangent = cotangent < 0.0f ? -1.0f / size : 1.0f / size;
                const float cosine = 1.0f / sqrt(1.0f + tangent * tangent);
                columns[one] = cosine * a - (cosine * tangent) * b;
                columns[other] = (cosine * tangent) * a + cosine * b;
            }
        }
    }
    const float3 lengths = sqrt((float3)(
        dot_product(columns[0], columns[0]), dot_product(columns[1], columns[1]),
        dot_product(columns[2], columns[2])));
    metric->half_lengths = lengths;
    metric->axes[0] = columns[0] / lengths.x;
    metric->axes[1] = columns[1] / lengths.y;
    metric->axes[2] = columns[2] / lengths.z;
    const float least = smaller(lengths.x, smaller(lengths.y, lengths.z));
    const float most = larger(lengths.x, larger(lengths.y, lengths.z));
    metric->keeps_spheres = most - least <= EQUAL_SLACK * most;
}
#endif

// The way from a point to the zero of an instance's local coordinates.
INLINED float3 way_to_instance(const global instance_t *instance, const float3 position, const float3 position_low)
{
    float3 low;
    const float3 way = add_exactly(load3(instance->centre), -position, &low);
    return way + (low + (load3(instance->centre_low) - position_low));
}

// Makes the metric of an instance for a point, given the way from the point to the instance.
INLINED metric_t make_metric(const global instance_t *instance, const float3 way)
{
    metric_t metric;
    const float3 size = magnitude(way);
    metric.unit = unit_scale((float3)(larger(size.x, larger(size.y, size.z)), instance->radius, 0.0f));
    metric.offset = metric.unit * way;
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            metric.to_scene[row][column] = metric.unit * instance->to_scene[row][column];
        }
    }
    rotate_axes(&metric);
#if HAS_SPHERES
    if (instance->kind == KIND_SPHERES) {
        find_axes(&metric);
    }
#endif
    return metric;
}

// Makes the metric of a geometry's own local coordinates.
INLINED metric_t make_local_metric(const float3 position)
{
    metric_t metric;
    for (int row = 0; row < 3; row++) {
        for (int column = 0; column < 3; column++) {
            metric.to_scene[row][column] = row == column ? 1.0f : 0.0f;
        }
    }
    metric.unit = 1.0f;
    metric.offset = -position;
    rotate_axes(&metric);
    return metric;
}
