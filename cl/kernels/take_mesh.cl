// Takes a mesh whose arrays are on the device already: bounds, checks, and local coordinates, see `LocalFrame`.
//
// IS_DOUBLE as 1: vertices of doubles.
//
// vertices[vertex_count]   packed
// faces[corner_count]      vertices, as one list
// bounds[items][2][3]      least and greatest coordinates that each work-item has seen
// is_wrong                 1 where a coordinate is not finite, or a face has no such vertex
// local_vertices[]         packed

#ifndef IS_DOUBLE
#define IS_DOUBLE 0
#endif

// keep: no contraction
#include "math/numeric.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#if IS_DOUBLE
typedef double coordinate_t;
#else
typedef float coordinate_t;
#endif

kernel void bound_vertices(
    const global coordinate_t *vertices, const int vertex_count, global coordinate_t *bounds, global int *is_wrong)
{
    const int item = (int)get_global_id(0);
    coordinate_t least[3];
    coordinate_t most[3];
    for (int axis = 0; axis < 3; axis++) {
        least[axis] = most[axis] = vertices[axis];
    }
    for (int vertex = item; vertex < vertex_count; vertex += (int)get_global_size(0)) {
        for (int axis = 0; axis < 3; axis++) {
            const coordinate_t own = vertices[3 * (long)vertex + axis];
            least[axis] = own < least[axis] ? own : least[axis];
            most[axis] = own > most[axis] ? own : most[axis];
            // Infinity minus infinity is NaN, too.
            if (!(own - own == 0)) {
                *is_wrong = 1;
            }
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        bounds[6 * item + axis] = least[axis];
        bounds[6 * item + 3 + axis] = most[axis];
    }
}

kernel void check_faces(
    const global uint *faces, const int face_count, const int vertex_count, global int *is_wrong)
{
    const int face = (int)get_global_id(0);
    if (face >= face_count) {
        return;
    }
    // Negative numbers are great ones, too.
    for (int corner = 0; corner < 3; corner++) {
        if (faces[3 * (long)face + corner] >= (uint)vertex_count) {
            *is_wrong = 1;
        }
    }
}

kernel void localize(
    const global coordinate_t *vertices, const int vertex_count, const double x, const double y, const double z,
    const double scale, global float *local_vertices)
{
    const int vertex = (int)get_global_id(0);
    if (vertex >= vertex_count) {
        return;
    }
    const double origin[3] = {x, y, z};
    for (int axis = 0; axis < 3; axis++) {
        const double own = vertices[3 * (long)vertex + axis];
        local_vertices[3 * (long)vertex + axis] = (float)((own - origin[axis]) * scale);
    }
}
