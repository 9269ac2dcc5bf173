// meet_by_beam: the beam of rays BEAM_RAYS * i and those that follow, against the boxes in node i.
//
// nodes[count]
// rays[BEAM_RAYS * count]
// met[count]                           written; a bit for each child that the beam may meet; ANYTHING if it goes
//                                      everywhere

#include "entry.cl"

kernel void meet_by_beam(
    const global node_t *restrict nodes, const global ray_t *restrict rays, global uint *restrict met, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    ray_bounds_t bounds = no_rays();
    for (int ray = BEAM_RAYS * i; ray < BEAM_RAYS * (i + 1); ray++) {
        include_ray(&bounds, ((const global float8 *)rays)[ray]);
    }
    const beam_t beam = make_beam(&bounds);
    met[i] = beam.is_empty ? 0 : beam.is_anything ? ANYTHING : beam_meets_children(nodes + i, &beam);
}
