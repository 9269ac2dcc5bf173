// Points as devices take them: in the world's local coordinates, as pairs of float32.

#include "structs.cl"
#include "rays/pack.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

INLINED double3 localize_point(const double3 point, const tree_box_t *box)
{
    return (point - box->centre) * box->scale;
}

INLINED bool is_finite_point(const double3 local_point)
{
    // Infinity minus infinity is NaN.
    const double3 nothing = local_point - local_point;
    return nothing.x == 0.0 && nothing.y == 0.0 && nothing.z == 0.0;
}

// How far away a primitive may be in local coordinates, rounded up, given the same in the file's unit.
INLINED float localize_limit(const double limit, const tree_box_t *box)
{
    return (float)(limit * box->scale) * (1.0f + 0x1p-20f) + FLT_MIN;
}

// Moves a point in local coordinates that is far away towards the centre, see `FAR_POINT_SHARE`.
INLINED double3 come_near(const double3 local_point, const tree_box_t *box)
{
    const double farthest = FAR_POINT_SHARE * largest_size(box->half_size);
    const double size = largest_size(local_point);
    const double share = size > farthest ? farthest / size : 1.0;
    return local_point * share;
}
