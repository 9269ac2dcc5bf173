// A crossing: a point in which a ray meets a triangle.

#include "rays/ray.cl"

typedef struct {
    float t;
    float u;
    float v;
    int prim_id;
    int triangle_index;  // of the triangle on the device, see corners_at
} crossing_t;

INLINED crossing_t no_crossing(void)
{
    const crossing_t none = {INFINITY, 0.0f, 0.0f, NO_PRIM, -1};
    return none;
}

INLINED bool is_found(const crossing_t *crossing)
{
    return crossing->prim_id != NO_PRIM;
}

INLINED hit_t as_hit(const crossing_t *crossing)
{
    const hit_t hit = {crossing->t, crossing->u, crossing->v, crossing->prim_id};
    return hit;
}

INLINED hit_t no_hit(void)
{
    const crossing_t none = no_crossing();
    return as_hit(&none);
}
