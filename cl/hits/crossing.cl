// A crossing: a point in which a ray meets a triangle.
//
// EXACT: see exact/ray.cl. A hit then has the low part of t in the place of v; nobody reads the v of a hit.

#include "rays/ray.cl"

typedef struct {
    float t;
    float u;
    float v;
    int prim_id;
    int triangle_index;  // of the triangle on the device, see corners_at
#if EXACT
    float t_low;         // what float32 has rounded off t
    float t_error;       // how far t may be off beside that; 0 where float64 has computed it
    bool is_front;       // the side that the ray meets, where float64 has computed it
#endif
} crossing_t;

INLINED crossing_t no_crossing(void)
{
    const crossing_t none = {INFINITY, 0.0f, 0.0f, NO_PRIM, -1};
    return none;
}

// A t as precise as the test of a primitive finds it.
#if EXACT
typedef double precise_t;
#else
typedef float precise_t;
#endif

#if EXACT

// Gives a crossing its t as a pair of floats.
INLINED void set_exact_t(crossing_t *crossing, const double t)
{
    crossing->t = (float)t;
    crossing->t_low = (float)(t - (double)crossing->t);
    crossing->t_error = 0.0f;
}

INLINED double exact_t_of(const crossing_t *crossing)
{
    return (double)crossing->t + (double)crossing->t_low;
}

#endif

INLINED bool is_found(const crossing_t *crossing)
{
    return crossing->prim_id != NO_PRIM;
}

INLINED hit_t as_hit(const crossing_t *crossing)
{
#if EXACT
    const hit_t hit = {crossing->t, crossing->u, crossing->t_low, crossing->prim_id};
#else
    const hit_t hit = {crossing->t, crossing->u, crossing->v, crossing->prim_id};
#endif
    return hit;
}

INLINED hit_t no_hit(void)
{
    const crossing_t none = no_crossing();
    return as_hit(&none);
}
