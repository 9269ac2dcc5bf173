// A ray in float64, for primitives that float32 cannot tell apart; see exact/triangle.cl.
//
// EXACT, if defined as 1: float32 alone excludes what a ray surely misses, and float64 decides about the rest, on the
// file's own vertices. The host asks for it where a world spans scales, see clbvh/trace/world/exact.py.
//
// Arguments that all kernels share, NULL without EXACT:
//
// exact_instances[]    exact_instance_t: of the instances, by their ids; one of a lone shape
// exact_vertices[]     double[3]: the vertices of all meshes, one mesh after the other, in the coordinates of the file
// exact_faces[]        int[3]: their faces; indices count within a mesh
// exact_solids[]       double: the numbers of all other primitives, see `SurfaceArrays.solids`

// keep: defines EXACT, and expanded before the branch
#include "structs.cl"
#include "math/numeric.cl"

// What there is of a ray in a buffer, beside the ray in float32.
#if EXACT
typedef packed_exact_ray_t ray_rest_t;
#else
typedef ray_low_t ray_rest_t;
#endif

#if EXACT

// keep: doubles
#include "math/doubles.cl"

typedef struct {
    const global exact_instance_t *instances;
    const global double *vertices;
    const global int *faces;
    const global double *solids;
} exact_shapes_t;

typedef struct {
    double3 origin;     // the world's local coordinates, as the direction
    double3 direction;
    double t_shift;     // t of this ray less that of the ray in float32
    float blur;         // how far the map to the shape may have moved the ray in float32 beside that ray's own rounding
    exact_shapes_t shapes;
    const global exact_instance_t *instance;
} exact_ray_t;

INLINED double3 load_double3(const global double *from)
{
    return (double3)(from[0], from[1], from[2]);
}

INLINED double3 transform_exactly(const global double rows[3][3], const double3 v)
{
    return (double3)(
        dot3(load_double3(rows[0]), v), dot3(load_double3(rows[1]), v), dot3(load_double3(rows[2]), v));
}

// A point of the file in the local coordinates of its shape.
INLINED double3 to_shape(const global exact_instance_t *instance, const double3 point)
{
    return (point - load_double3(instance->origin)) * instance->scale;
}

#endif
