// Distances within an instance are those of the scene: corners are moved into the scene, with the point at zero, and
// boxes are measured in the geometry's local coordinates by weights that never make a distance too large.
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
    float3 weights;        // of differences along the local axes: the weighted length is at most the one in the scene
    float slack;           // bound on the error of a distance minus that of the box's distance
    float unit;            // units of the metric in one of the scene's
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

INLINED float3 column_of(const metric_t *metric, const int column)
{
    return (float3)(metric->to_scene[0][column], metric->to_scene[1][column], metric->to_scene[2][column]);
}

INLINED float sum_of(const float3 v)
{
    return v.x + v.y + v.z;
}

// The product of a matrix with a vector, of their magnitudes.
INLINED float3 multiply_magnitudes(const float3 rows[3], const float3 v)
{
    return (float3)(
        dot_product(magnitude(rows[0]), v), dot_product(magnitude(rows[1]), v), dot_product(magnitude(rows[2]), v));
}

INLINED float3 lengths_of(const float3 a, const float3 b, const float3 c)
{
    return sqrt((float3)(dot_product(a, a), dot_product(b, b), dot_product(c, c)));
}

// Finds the weights. The columns of the map, each divided by its length, are a matrix whose least singular value is at
// least the root of 1 minus the largest sum of cosines of one column with the others (Gershgorin's theorem): it is 1 if
// the map scales along the local axes and rotates then. With it, the lengths of the columns are weights.
INLINED float3 find_weights(const metric_t *metric, const float least_stretch)
{
    const float3 x = column_of(metric, 0);
    const float3 y = column_of(metric, 1);
    const float3 z = column_of(metric, 2);
    const float3 lengths = lengths_of(x, y, z);
    const float3 cosines = magnitude(
        (float3)(dot_product(y, z), dot_product(z, x), dot_product(x, y)) / (lengths.yzx * lengths.zxy));
    const float most = sum_of(cosines) - smaller(cosines.x, smaller(cosines.y, cosines.z));
    const float3 weights = sqrt(1.0f - EQUAL_SLACK - most) * lengths;
    // Not so for NaN.
    const bool is_better = smaller(weights.x, smaller(weights.y, weights.z)) >= least_stretch;
    return is_better ? weights : (float3)(least_stretch);
}

#if HAS_SPHERES
// Finds the axes of the ellipsoids: the columns of the map are rotated in pairs until they are orthogonal (one-sided
// Jacobi: Hestenes, "Inversion of matrices by biorthogonalization and related results", 1958).
INLINED void find_axes(metric_t *metric)
{
    float3 columns[3] = {column_of(metric, 0), column_of(metric, 1), column_of(metric, 2)};
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
    const float3 lengths = lengths_of(columns[0], columns[1], columns[2]);
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
    float3 to_scene[3];
    float3 to_object[3];
    for (int row = 0; row < 3; row++) {
        to_scene[row] = metric.unit * load3(instance->to_scene[row]);
        to_object[row] = load3(instance->to_object[row]);
        metric.to_scene[row][0] = to_scene[row].x;
        metric.to_scene[row][1] = to_scene[row].y;
        metric.to_scene[row][2] = to_scene[row].z;
    }
    metric.weights = find_weights(&metric, instance->least_stretch * metric.unit);
#if HAS_SPHERES
    if (instance->kind == KIND_SPHERES) {
        find_axes(&metric);
    }
#endif
    // Coordinates within the geometry are at most 1. The point's local coordinates have the errors of `to_object`,
    // which was rounded apart from `to_scene`: both together are off by what the products of magnitudes say.
    const float3 position = multiply_magnitudes(to_object, magnitude(way));
    const float3 there_and_back = multiply_magnitudes(to_object, multiply_magnitudes(to_scene, position) / metric.unit);
    const float of_box = dot_product(metric.weights, there_and_back) + sum_of(metric.weights);
    const float of_corner = sum_of(multiply_magnitudes(to_scene, (float3)(1.0f))) + sum_of(magnitude(metric.offset));
    const float slack = ERROR_BOUND(16) * (of_box + of_corner);
    // Without a bound every box counts.
    metric.slack = slack < INFINITY ? slack : INFINITY;
    return metric;
}
