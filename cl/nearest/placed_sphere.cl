// The distance of the point from a sphere of a placed geometry: of a single one, or, if WIDTH is defined, of WIDTH
// spheres in lanes. Both have the same bits.

#include "nearest/ellipsoid.cl"
#include "nearest/metric.cl"
#include "nearest/point_sphere.cl"
#include "nearest/point_triangle.cl"
#include "nearest/search.cl"

// The primitives are balls: at distance zero from the points inside, and not near any others.
#define KIND_BALLS (KIND_SPHERES + 1)

// The squared distance, in units of the metric, from the ellipsoid that a sphere is in the scene.
INLINED float distance_squared_to_stretched_sphere(
    const metric_t *metric, const float x, const float y, const float z, const float radius)
{
    const float3 centre = (float3)(x, y, z);
    const float3 position = transform_vector(metric->record->axes, centre);
    const float3 half_lengths = load3(metric->record->half_lengths) * (metric->unit * radius);
    return distance_squared_to_ellipsoid(magnitude(position), half_lengths);
}

// The squared distance in units of the metric; `centre` and `radius` are in the geometry's local coordinates.
INLINED real_t distance_squared_to_placed_sphere(const nearest_t *nearest, const point_t centre, const real_t radius)
{
    const metric_t *metric = &nearest->metric;
    const point_t placed = place_point(metric, centre.x, centre.y, centre.z);
    if (nearest->kind == KIND_BALLS) {
        return dot_of(placed, placed) < radius * radius ? (real_t)(0.0f) : (real_t)(INFINITY);
    }
    if (metric->record->keeps_spheres) {
        return distance_squared_to_sphere(placed, metric->record->half_lengths[0] * (metric->unit * radius));
    }
#ifdef WIDTH
    union {
        lanes_t lanes[4];
        float of_lane[4][WIDTH];
    } spheres = {{placed.x, placed.y, placed.z, radius}};
    union {
        lanes_t lanes;
        float of_lane[WIDTH];
    } squared;
    for (int lane = 0; lane < WIDTH; lane++) {
        squared.of_lane[lane] = distance_squared_to_stretched_sphere(
            metric, spheres.of_lane[0][lane], spheres.of_lane[1][lane], spheres.of_lane[2][lane],
            spheres.of_lane[3][lane]);
    }
    return squared.lanes;
#else
    return distance_squared_to_stretched_sphere(metric, placed.x, placed.y, placed.z, radius);
#endif
}
