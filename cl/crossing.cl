// The nearest crossing of a ray with a triangle found so far.

#include "ray.cl"

typedef struct {
    float t;
    float u;
    float v;
    int prim_id;
    int place;  // where the triangle is in the array of triangles
} crossing_t;

crossing_t no_crossing(void)
{
    const crossing_t none = {INFINITY, 0.0f, 0.0f, NO_PRIM, -1};
    return none;
}

bool is_found(const crossing_t *crossing)
{
    return crossing->prim_id != NO_PRIM;
}

// How far along the ray a nearer crossing can still be.
float search_limit(const crossing_t *crossing, const path_t *path)
{
    return smaller(crossing->t, path->t_max);
}

hit_t as_hit(const crossing_t *crossing)
{
    const hit_t hit = {crossing->t, crossing->u, crossing->v, crossing->prim_id};
    return hit;
}
