// The nearest primitives of each point, in any order. None that is left out is nearer than the first one says.
//
// Shared arguments: see cl/world/world.cl and cl/world/points.cl.
// metrics[]                       see cl/world/nearest.cl
// hits[point_count * slots]       written: t is a lower bound on the distance, see near_heap_t, of the first one the
//                                 largest; NO_PRIM in slots that are left

#include "world/nearest.cl"

kernel void closest_points(WORLD_ARGUMENTS, POINT_ARGUMENTS,
    const global metric_record_t *restrict metrics, SLOT_ARGUMENTS)
{
    OPEN_POINT;
    const world_t world = WORLD(root_of(nodes));
    const near_heap_t heap = {hits + (size_t)place * slots, slots, 0, is_single, INFINITY};
    const world_nearest_t nearest = find_world_nearest(&world, metrics, &point, heap);
    for (int slot = nearest.kept.count; slot < slots; slot++) {
        heap.heap[slot] = as_kept(INFINITY, NO_PRIM, NO_PRIM);
    }
    // None that is left out is nearer than the limit; nor are those that were found before it.
    if (nearest.kept.limit < INFINITY) {
        for (int slot = 0; slot < slots; slot++) {
            heap.heap[slot].prim_id = heap.heap[slot].t > nearest.kept.limit ? NO_PRIM : heap.heap[slot].prim_id;
        }
        heap.heap[0].t = smaller(heap.heap[0].t, nearest.kept.limit);
    }
    CHOOSE_PRIMS();
}
