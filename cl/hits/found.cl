// Hits as the host gets them from a device, of a lone shape or of a world with instances; and memory that is asked for
// before they are refined.

#include "structs.cl"
#include "hits/surfaces.cl"

// The struct behind `SurfaceArrays.addresses`. The host has doubles in any case; said here, it costs no branch.
INLINED surfaces_t surfaces_on_host(const ulong *addresses)
{
    surfaces_t surfaces = *(const surfaces_t *)addresses;
    surfaces.has_doubles = 1;
    return surfaces;
}

// One of both is NULL.
typedef struct {
    const hit_t *of_lone;
    const world_hit_t *of_world;
} found_hits_t;

// The initializer of a found_hits_t from hits of kernels, see hits/search.cl.
#if LONE
#define FOUND_HITS(hits) {(hits), 0}
#else
#define FOUND_HITS(hits) {0, (hits)}
#endif

INLINED int prim_of(const found_hits_t *found, const long hit)
{
    return found->of_lone ? found->of_lone[hit].prim_id : found->of_world[hit].prim_id;
}

INLINED float t_of(const found_hits_t *found, const long hit)
{
    return found->of_lone ? found->of_lone[hit].t : found->of_world[hit].t;
}

INLINED int instance_of(const found_hits_t *found, const long hit)
{
    return found->of_lone ? 0 : found->of_world[hit].instance_id;
}

// Of a sphere, u is 0 where the ray enters and 1 where it leaves.
INLINED bool is_leaving(const found_hits_t *found, const long hit)
{
    return (found->of_lone ? found->of_lone[hit].u : found->of_world[hit].u) != 0.0f;
}

INLINED void will_read_found(const found_hits_t *found, const long hit)
{
    WILL_READ(found->of_lone ? (const char *)(found->of_lone + hit) : (const char *)(found->of_world + hit));
}

// Asks for the face of a hit, or for its sphere.
INLINED void will_read_prim(const surfaces_t *surfaces, const found_hits_t *found, const long hit)
{
    const int prim = prim_of(found, hit);
    if (prim != NO_PRIM) {
        const int geometry = surfaces->geometry_id[instance_of(found, hit)];
        if (IS_SPHERES(surfaces->kind[geometry])) {
            WILL_READ(sphere_at(surfaces, geometry, prim));
        } else {
            WILL_READ(face_at(surfaces, geometry, prim));
        }
    }
}

// Asks for the corners of a triangle that is hit.
INLINED void will_read_corners(const surfaces_t *surfaces, const found_hits_t *found, const long hit)
{
    const int prim = prim_of(found, hit);
    if (prim != NO_PRIM) {
        const int geometry = surfaces->geometry_id[instance_of(found, hit)];
        if (IS_TRIANGLES(surfaces->kind[geometry])) {
            const global int *face = face_at(surfaces, geometry, prim);
            for (int corner = 0; corner < 3; corner++) {
                WILL_READ(vertex_at(surfaces, surfaces->first_vertex[geometry] + face[corner]));
            }
        }
    }
}
