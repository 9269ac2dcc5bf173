// The primitives that may meet each upright box: all whose own box, grown by more than float32 rounds, does.
//
// A box that fills its slots may meet more: the host looks it up again with more slots.
//
// Shared arguments: see cl/world/world.cl and cl/world/points.cl; the points are the middles of the boxes.
// metrics[]                       see cl/world/nearest.cl
// half_sides[point_count][3]      half the sides of each box, in the world's local coordinates
// hits[point_count * slots]       written: NO_PRIM in slots that are left
// slots                           results per box, at least 1

#include "world/nearest.cl"

kernel void prims_in_boxes(WORLD_ARGUMENTS, POINT_ARGUMENTS,
    const global metric_record_t *restrict metrics, const global float *restrict half_sides,
    global kept_hit_t *restrict hits, const int slots)
{
    OPEN_POINT;
    const world_t world = WORLD(root_of(nodes));
    point_pair_t middle = point;
    middle.is_box = true;
    middle.half_sides = load3(half_sides + 3 * (size_t)point_id);
    const near_heap_t heap = {hits + (size_t)place * slots, slots, 0, false, INFINITY};
    const world_nearest_t nearest = find_world_nearest(&world, metrics, &middle, heap);
    for (int slot = nearest.kept.count; slot < slots; slot++) {
        heap.heap[slot] = as_kept(INFINITY, NO_PRIM, NO_PRIM);
    }
}
