// beam_meets_children: the beam of rays BEAM_RAYS * i and those that follow, against the boxes in node i.
//
// nodes[count]
// rays[BEAM_RAYS * count]
// met[count]                  written: one bit per child, set where the beam may meet it; UNBOUNDED for a beam without
//                             bounds

#include "traversal/traverse.cl"
#include "boxes/beam.cl"

// As in tests/kernel/test_beam.py.
#define BEAM_RAYS 8
#define UNBOUNDED (1 << 20)

kernel void meet_by_beam(
    const global node_t *restrict nodes, const global packed_ray_t *restrict rays, global uint *restrict met,
    const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    ray_bounds_t bounds = empty_bounds();
    for (int ray = BEAM_RAYS * i; ray < BEAM_RAYS * (i + 1); ray++) {
        include_ray(&bounds, ((const global float8 *)rays)[ray]);
    }
    const beam_t beam = make_beam(&bounds);
    met[i] = beam.is_empty ? 0 : beam.is_unbounded ? UNBOUNDED : beam_meets_children(nodes + i, &beam);
}
