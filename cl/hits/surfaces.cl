// The surfaces of a world in double, by `SurfaceArrays` of clbvh/trace/world/surface_arrays.py, which tells what each
// array holds.

#include "rays/arrays.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// In the order of `SurfaceArrays.addresses`. A kernel may leave out what it does not read.
typedef struct {
    // As bytes: doubles where `has_doubles` is not 0, else floats.
    const global char *vertices;
    const global int *faces;
    const global double *solids;
    global float *margins;
    const global int *kind;
    const global long *first_vertex;
    const global long *first_face;
    const global long *first_solid;
    const global double *origin;
    const global double *scale;
    const global double *half_size;
    const global int *geometry_id;
    const global double *linear;
    const global double *offset;
    const global double *inverse;
    const global double *world_scale;
    const global uchar *is_mirrored;
    long is_lone;
    double rounding;
    long has_doubles;
} surfaces_t;

// The corners of a triangle.
typedef struct {
    double3 a;
    double3 b;
    double3 c;
} wide_corners_t;

INLINED double3 load_wide_row(const global double *rows, const long row)
{
    return (double3)(rows[3 * row], rows[3 * row + 1], rows[3 * row + 2]);
}

// The product of one of some matrices and a vector.
INLINED double3 multiply(const global double *matrices, const long index, const double3 v)
{
    const global double *rows = matrices + 9 * index;
    return (double3)(
        rows[0] * v.x + rows[1] * v.y + rows[2] * v.z, rows[3] * v.x + rows[4] * v.y + rows[5] * v.z,
        rows[6] * v.x + rows[7] * v.y + rows[8] * v.z);
}

INLINED const global char *vertex_at(const surfaces_t *surfaces, const long vertex)
{
    return surfaces->vertices + 3 * (surfaces->has_doubles ? sizeof(double) : sizeof(float)) * vertex;
}

INLINED double3 load_vertex(const surfaces_t *surfaces, const long vertex)
{
    const bool is_double = surfaces->has_doubles;
    return load_vector(vertex_at(surfaces, vertex), is_double ? sizeof(double) : sizeof(float), is_double);
}

INLINED const global int *face_at(const surfaces_t *surfaces, const int geometry, const int prim)
{
    return surfaces->faces + 3 * (surfaces->first_face[geometry] + prim);
}

// In the coordinates of the triangle's object.
INLINED wide_corners_t load_wide_corners(const surfaces_t *surfaces, const int geometry, const int prim)
{
    const global int *face = face_at(surfaces, geometry, prim);
    const long first = surfaces->first_vertex[geometry];
    const wide_corners_t corners = {
        load_vertex(surfaces, first + face[0]), load_vertex(surfaces, first + face[1]),
        load_vertex(surfaces, first + face[2])};
    return corners;
}

// The centre of a sphere, and its radius behind it.
INLINED const global double *sphere_at(const surfaces_t *surfaces, const int geometry, const int prim)
{
    return surfaces->solids + surfaces->first_solid[geometry] + 4 * (long)prim;
}
