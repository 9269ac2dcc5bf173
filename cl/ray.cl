// A ray as traversal wants it: with what the box test and the triangle test derive from its direction.

#include "layout.cl"
#include "numeric.cl"

typedef struct {
    float3 origin;
    float3 direction;
    float3 inverse;  // 1 / direction; of a zero, infinity with the zero's sign
    float3 shear;    // see permute_axes: x / z, y / z and 1 / z of the permuted direction
    int axis;        // the axis of the direction's largest component
    float t_min;
    float t_max;
} path_t;

// Turn a vector so that component `axis` becomes z. The turn is cyclic: it keeps the orientation of triangles.
INLINED float3 permute_axes(const float3 v, const int axis)
{
    return axis == 0 ? v.yzx : axis == 1 ? v.zxy : v;
}

// The direction is finite, not zero, and of moderate length (1e-18 to 1e18); t_min >= 0.
INLINED path_t make_path(const float3 origin, const float3 direction, const float t_min, const float t_max)
{
    path_t path;
    path.origin = origin;
    path.direction = direction;
    path.t_min = t_min;
    path.t_max = t_max;
    path.inverse = 1.0f / direction;

    const float3 size = magnitude(direction);
    path.axis = size.x > size.y ? (size.x > size.z ? 0 : 2) : (size.y > size.z ? 1 : 2);
    const float3 turned = permute_axes(direction, path.axis);
    path.shear = (float3)(turned.x / turned.z, turned.y / turned.z, 1.0f / turned.z);
    return path;
}

INLINED path_t load_path(const global ray_t *ray)
{
    return make_path(load3(ray->origin), load3(ray->direction), ray->t_min, ray->t_max);
}
