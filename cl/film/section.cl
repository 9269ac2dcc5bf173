// The section of closed objects where a cut opens them, filled with a colour of its own.
//
// HAS_CUT: see world/cut.cl.

#include "world/cut.cl"
#include "world/surface.cl"

#if HAS_CUT

// The share of its brightness that the section has in the lines of its hatching, which take this share of its spacing.
#define HATCHING_SHARE 0.5f
#define HATCHING_WIDTH 0.2f

// Whether a ray of the camera comes out of the cut inside of a closed object: it leaves one at its first hit behind it.
// `closed` tells of each instance whether it encloses a volume.
INLINED bool shows_section(
    const global view_t *view, const global uchar *closed, const world_t *world, const world_ray_t *ray,
    const search_t *found)
{
    if (!view->has_section || !closed || !is_found(&found->nearest)) {
        return false;
    }
    const cut_range_t cut = find_cut_range(view, ray);
    if (!(cut.begin <= cut.end && cut.end > 0.0f && found->nearest.t >= cut.end)) {
        return false;
    }
    const world_surface_t surface = world_surface_at(world, ray, found);
    return surface.is_back && closed[surface.instance_id];
}

// The colour of a section in a pixel, in the kind of numbers that the shading computes.
INLINED float3 section_colour(const global view_t *view, const int column, const int row)
{
    const int spacing = view->section_hatch;
    const bool is_line = spacing > 0 && (float)((column + row) % spacing) < HATCHING_WIDTH * (float)spacing;
    return (is_line ? HATCHING_SHARE : 1.0f) * load3(view->section_colour);
}

#endif
