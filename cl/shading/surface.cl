// The point of a crossing on its triangle, with the surface normal there.

#include "math/vectors.cl"
#include "triangles/triangle.cl"

typedef struct {
    float3 position;
    float3 normal;  // unit vector on the side of the ray's origin
    float3 error;   // bound on the rounding error of each coordinate of the position
    bool is_back;   // whether the ray comes from the side from which the corners are clockwise
} surface_t;

#if EXACT

// The edges from the first corner of a triangle of the file, in the shape's local coordinates: corners that float32
// cannot tell apart have no normal.
INLINED corners_t exact_edges(const exact_shapes_t *shapes, const int instance_id, const int prim_id)
{
    const global exact_instance_t *instance = shapes->instances + instance_id;
    const global int *face = shapes->faces + 3 * (instance->first_face + prim_id);
    double3 at[3];
    for (int corner = 0; corner < 3; corner++) {
        at[corner] = to_shape(instance, load_double3(shapes->vertices + 3 * (instance->first_vertex + face[corner])));
    }
    const double size = most_of(largest_size(at[1] - at[0]), largest_size(at[2] - at[0]));
    const corners_t edges = {
        (float3)(0.0f), convert_float3((at[1] - at[0]) / size), convert_float3((at[2] - at[0]) / size)};
    return edges;
}

#endif

// `edges` are the corners whose normal is the surface's.
INLINED surface_t surface_at(
    const corners_t *corners, const corners_t *edges, const crossing_t *crossing, const float3 direction)
{
    const float3 from_a = (1.0f - crossing->u - crossing->v) * corners->a;
    const float3 from_b = crossing->u * corners->b;
    const float3 from_c = crossing->v * corners->c;

    surface_t surface;
    surface.position = from_a + from_b + from_c;
    // At most seven roundings from a corner to the sum (Pharr, Jakob and Humphreys, "Physically based
    // rendering", section 6.8, 2023).
    surface.error = ERROR_BOUND(7) * (magnitude(from_a) + magnitude(from_b) + magnitude(from_c));
    const float3 normal = normal_of_edges(edges->b - edges->a, edges->c - edges->a);
    surface.is_back = dot_product(normal, direction) > 0.0f;
    surface.normal = surface.is_back ? -normal : normal;
    return surface;
}

// A triangle in the plane of two axes, as that of a flat mesh, has no rounding error across that plane. The distance is
// added to the others: one in which coordinates other than 0 lose it. A ray that begins at a distance of 0 would meet
// the triangle at t = 0.
#define LEAST_DISTANCE 1e-20f

// A point just above the surface, from which a ray cannot meet the triangle that it leaves. The distance is derived
// from the rounding error of the position, not from a constant, so it fits meshes of any size.
INLINED float3 point_above(const surface_t *surface)
{
    const float distance = dot_product(magnitude(surface->normal), surface->error);
    return surface->position + (2.0f * distance + LEAST_DISTANCE) * surface->normal;
}

// The same surface with the largest error in all directions. The t of a ray along a surface has the rounding of the
// ray's own direction: with less, a ray from a plane at z = 0 could meet that plane at t = 1e-8.
INLINED surface_t with_even_error(const surface_t *surface)
{
    surface_t even = *surface;
    even.error = (float3)(larger(surface->error.x, larger(surface->error.y, surface->error.z)));
    return even;
}

// A point just below the surface, for a ray that goes through it.
INLINED float3 point_below(const surface_t *surface)
{
    const float distance = dot_product(magnitude(surface->normal), surface->error);
    return surface->position - (2.0f * distance + LEAST_DISTANCE) * surface->normal;
}
