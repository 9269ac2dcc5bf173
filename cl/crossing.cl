// The nearest crossing found so far.

#include "ray.cl"

hit_t no_hit(void)
{
    const hit_t hit = {INFINITY, 0.0f, 0.0f, NO_PRIM};
    return hit;
}

bool is_hit(const hit_t *hit)
{
    return hit->prim_id != NO_PRIM;
}

// How far along the ray a nearer crossing can still be.
float search_limit(const hit_t *hit, const path_t *path)
{
    return smaller(hit->t, path->t_max);
}
