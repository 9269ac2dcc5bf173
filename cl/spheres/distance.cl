// The distance of the point from a sphere's surface: of a single one, or, if WIDTH is defined, of WIDTH spheres in
// lanes. Both are the same arithmetic with the same bits.

#include "nearest/metric.cl"
#include "nearest/point_triangle.cl"
#include "nearest/search.cl"
#if !LONE
#include "nearest/ellipsoid.cl"
#endif

#if !LONE
// The squared distance, in units of the metric, from the ellipsoid that a sphere is in the world.
INLINED float distance_squared_to_stretched_sphere(
    const metric_t *metric, const float x, const float y, const float z, const float radius)
{
    const float3 position = transform_vector(metric->record->axes, (float3)(x, y, z));
    const float3 half_lengths = load3(metric->record->half_lengths) * (metric->unit * radius);
    return distance_squared_to_ellipsoid(magnitude(position), half_lengths);
}
#endif

// The squared distance in units of the metric; `centre` and `radius` are in the shape's local coordinates.
INLINED real_t distance_squared_to_sphere(const nearest_t *nearest, const point_t centre, real_t radius)
{
    const metric_t *metric = &nearest->metric;
    const point_t placed = place_point(metric, centre.x, centre.y, centre.z);
    if (nearest->is_of_inside) {
        return dot_of(placed, placed) < radius * radius ? (real_t)(0.0f) : (real_t)(INFINITY);
    }
    if (nearest->is_of_box) {
        const point_t way = way_from(placed, placed, metric->half_sides);
#if !LONE
        const global float *lengths = metric->record->half_lengths;
        radius *= metric->unit * larger(lengths[0], larger(lengths[1], lengths[2]));
#endif
        const real_t height = LARGER(sqrt(dot_of(way, way)) - radius, (real_t)(0.0f));
        return height * height + (placed.x - placed.x);  // maxima may lose the NaN of a lane without a sphere
    }
#if !LONE
    if (!metric->record->keeps_spheres) {
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
    radius *= metric->record->half_lengths[0] * metric->unit;
#endif
    // Inside, the surface is as far as the radius is longer than the distance from the centre.
    const real_t height = sqrt(dot_of(placed, placed)) - radius;
    return height * height;
}
