// The metric of an instance, by row: distances in the scene's units from a box, a corner of it and a sphere.
//
// instances[count]          instance_t
// metrics[count]            metric_record_t: of the instances
// positions[3 * count]      float: of points, in the scene's local coordinates
// boxes[6 * count]          float: least and greatest coordinates within the geometry
// corners[3 * count]        float: a point of the box, local coordinates
// radii[count]              float: of a sphere around the corner
// to_box[count]             written: least distance of the box, without the slack
// slack[count]              written
// to_corner[count]          written: distance of the corner
// to_sphere[count]          written: distance of the sphere

#include "nearest/sphere.cl"

INLINED point_t point_at(const float3 v)
{
    const point_t point = {v.x, v.y, v.z};
    return point;
}

kernel void measure_placed(
    const global instance_t *restrict instances, const global metric_record_t *restrict metrics,
    const global float *restrict positions, const global float *restrict boxes, const global float *restrict corners,
    const global float *restrict radii,
    global float *restrict to_box, global float *restrict slack, global float *restrict to_corner,
    global float *restrict to_sphere, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const float3 way = way_to_instance(instances + i, vload3(i, positions), (float3)(0.0f));
    const nearest_t nearest = make_nearest(make_metric(instances + i, metrics + i, way), KIND_SPHERES);
    const float unit = nearest.metric.unit;
    const point_t outside =
        way_to_box(&nearest.metric, point_at(vload3(2 * i, boxes)), point_at(vload3(2 * i + 1, boxes)));
    to_box[i] = sqrt(dot_of(outside, outside)) / unit;
    slack[i] = nearest.metric.slack / unit;
    const float3 corner = vload3(i, corners);
    const point_t placed = place_point(&nearest.metric, corner.x, corner.y, corner.z);
    to_corner[i] = sqrt(dot_of(placed, placed)) / unit;
    to_sphere[i] = sqrt(distance_squared_to_sphere(&nearest, point_at(corner), radii[i])) / unit;
}
