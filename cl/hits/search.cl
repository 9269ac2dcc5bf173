// The state of a query during a traversal. Every layout reports each crossing once, by `add_crossing`; the query
// decides whether it is kept, and how far the traversal has to go on.
//
// The query is a constant wherever these functions are called, so inlining removes the code of the others.
//
// LONE: see world/world.cl.
//
// COUNT_STEPS, if defined as 1: the traversal counts its steps in `steps`, see kernels/count_steps.cl.

#include "hits/crossing.cl"
#include "rays/ray.cl"

// The nearest crossing. Ties go to the smaller prim_id, so the order of the tests does not matter.
#define QUERY_CLOSEST 0
// The number of crossings up to `max_count`; any hit is a count up to 1.
#define QUERY_COUNT 1
// The first `max_count` crossings along the ray, in `heap`.
#define QUERY_FIRST 2
// The number of crossings with faces that are not in `surplus`.
#define QUERY_PARITY 3

// The sides of primitives that a ray may see; see `SIDES` of clbvh/trace/rays/batch.py.
#define BOTH_SIDES 0
#define FRONT_SIDE 1
#define BACK_SIDE 2

// In the place of a kind where a kernel meets one alone: there IS_TRIANGLES, IS_SPHERES are constants.
#define ONLY_KIND -1

// A hit in the heap.
#if !LONE
typedef world_hit_t kept_hit_t;
#else
typedef hit_t kept_hit_t;
#endif

#if !LONE
// More than the rounding of a t that is moved from the ray inside an instance to the one outside, and back.
#define T_SLACK ERROR_BOUND(4)
#endif

// EXACT: more than what float32 has rounded off a t, and off the t at which a ray enters a box.
#if EXACT
#define LIMIT_GROWTH (1.0f + ERROR_BOUND(64))
#else
#define LIMIT_GROWTH 1.0f
#endif

typedef struct {
    crossing_t nearest;       // the nearest crossing; of a count, the last one
    int count;
    int max_count;            // at least 1
    global kept_hit_t *heap;  // [max_count]: binary heap with the farthest hit on top
#if !LONE
    // The instance in which crossings are found now, and where its ray begins on the ray outside, see
    // instances/instance.cl. After a traversal for the nearest crossing: those of the nearest crossing.
    int instance_index;
    int instance_id;
    precise_t t_shift;
    world_prim_t excluded_prim;  // that the ray does not see, or NO_PRIM
#endif
    int excluded;             // the same where it is one of the tree that is traversed
    int side;                 // of primitives that the ray sees
    int kind;                 // of the primitives of the tree that is traversed
#if COUNT_STEPS
    steps_t *steps;
#endif
    const global uint *surplus;  // a bit for each primitive, the first one in the lowest bit; NULL if all bits are 0
} search_t;

// Adds to a field of the steps. Other kernels have no code of it.
#if COUNT_STEPS
#define COUNT(search, field, number) (search)->steps->field += (number)
#else
#define COUNT(search, field, number)
#endif

INLINED search_t make_search(const int max_count, global kept_hit_t *heap)
{
#if !LONE
    const world_prim_t none = {NO_PRIM, NO_PRIM};
    const search_t search = {no_crossing(), 0, max_count, heap, -1, -1, 0.0f, none, NO_PRIM, BOTH_SIDES};
#else
    const search_t search = {no_crossing(), 0, max_count, heap, NO_PRIM, BOTH_SIDES};
#endif
    return search;
}

// Leaves a primitive out, unless that is NULL, and one side of all others.
INLINED void limit_sight(search_t *search, const int side, const global world_prim_t *excluded)
{
    search->side = side;
    if (excluded) {
        search->excluded = excluded->prim_id;
#if !LONE
        search->excluded_prim = *excluded;
#endif
    }
}

// Whether the ray does not see a primitive, or the side of it that it meets.
INLINED bool is_unseen(const search_t *search, const int prim_id, const bool is_front)
{
    return prim_id == search->excluded || search->side == (is_front ? BACK_SIDE : FRONT_SIDE);
}

// A crossing as it is kept in the heap.
INLINED kept_hit_t as_kept_hit(const search_t *search, const crossing_t *crossing)
{
#if !LONE && EXACT
    crossing_t outside = *crossing;
    set_exact_t(&outside, exact_t_of(crossing) + search->t_shift);
    const kept_hit_t hit = {
        outside.t, outside.u, outside.t_low, outside.prim_id, search->instance_id, crossing->t};
    return hit;
#elif !LONE
    const kept_hit_t hit = {
        crossing->t + search->t_shift, crossing->u, crossing->v, crossing->prim_id, search->instance_id, crossing->t};
    return hit;
#else
    return as_hit(crossing);
#endif
}

// Whether no further crossing can change the answer.
INLINED bool is_complete(const search_t *search, const int query)
{
    return query == QUERY_COUNT && search->count >= search->max_count;
}

// The largest t that a crossing may have.
INLINED float latest_t(const crossing_t *crossing)
{
#if EXACT
    return crossing->t + crossing->t_error;
#else
    return crossing->t;
#endif
}

// The largest t at which a crossing can still change the answer.
INLINED float search_limit(const search_t *search, const ray_t *ray, const int query)
{
    if (query == QUERY_CLOSEST) {
        return smaller(latest_t(&search->nearest), ray->t_max) * LIMIT_GROWTH;
    }
    if (query == QUERY_FIRST && search->count >= search->max_count) {
        const float farthest = search->heap[0].t;
#if !LONE
        // As t in the instance, rounded up.
        return (farthest - (float)search->t_shift + farthest * T_SLACK) * LIMIT_GROWTH;
#else
        return farthest * LIMIT_GROWTH;
#endif
    }
    return ray->t_max * LIMIT_GROWTH;
}

// Whether the first of two hits comes before the other one: by t, then by prim_id.
INLINED bool precedes(const float t, const int prim_id, const float other_t, const int other_prim_id)
{
    return t < other_t || (t == other_t && prim_id < other_prim_id);
}

// The order of hits along a ray.
INLINED bool comes_first(const kept_hit_t *a, const kept_hit_t *b)
{
#if EXACT
    // The low parts of t, see hits/crossing.cl.
    if (a->t == b->t && a->v != b->v) {
        return a->v < b->v;
    }
#endif
#if !LONE
    if (a->t == b->t && a->instance_id != b->instance_id) {
        return a->instance_id < b->instance_id;
    }
    // Of one instance, the order is that of t inside.
    if (a->t == b->t && a->t_inside != b->t_inside) {
        return a->t_inside < b->t_inside;
    }
#endif
    // A ray enters a sphere before it leaves it, also where float32 has one t for both.
    if (a->t == b->t && a->prim_id == b->prim_id) {
        return a->u < b->u;
    }
    return precedes(a->t, a->prim_id, b->t, b->prim_id);
}

// The order of crossings with one geometry along a ray.
INLINED bool is_nearer(const crossing_t *a, const crossing_t *b)
{
#if EXACT
    if (a->t == b->t && a->t_low != b->t_low) {
        return a->t_low < b->t_low;
    }
#endif
    return precedes(a->t, a->prim_id, b->t, b->prim_id);
}

// Replaces the hit in a slot; it moves down until none of its children is farther (Williams, "Heapsort", 1964).
INLINED void sink_hit(global kept_hit_t *heap, const int count, int slot, const kept_hit_t hit)
{
    for (int child = 2 * slot + 1; child < count; child = 2 * slot + 1) {
        kept_hit_t farther = heap[child];
        if (child + 1 < count) {
            const kept_hit_t other = heap[child + 1];
            if (comes_first(&farther, &other)) {
                farther = other;
                child++;
            }
        }
        if (!comes_first(&hit, &farther)) {
            break;
        }
        heap[slot] = farther;
        slot = child;
    }
    heap[slot] = hit;
}

// Appends a hit in the slot behind the last one: it moves up until its parent is farther.
INLINED void append_hit(global kept_hit_t *heap, int slot, const kept_hit_t hit)
{
    while (slot > 0) {
        const kept_hit_t parent = heap[(slot - 1) / 2];
        if (!comes_first(&parent, &hit)) {
            break;
        }
        heap[slot] = parent;
        slot = (slot - 1) / 2;
    }
    heap[slot] = hit;
}

// Sorts the heap into the order along the ray.
INLINED void sort_hits(const search_t *search)
{
    for (int end = search->count - 1; end > 0; end--) {
        const kept_hit_t last = search->heap[end];
        search->heap[end] = search->heap[0];
        sink_hit(search->heap, end, 0, last);
    }
}

// Adds a hit to a heap with room for `most` hits, unless they come before it; returns their number.
INLINED int keep_first(global kept_hit_t *heap, const int count, const int most, const kept_hit_t hit)
{
    if (count < most) {
        append_hit(heap, count, hit);
        return count + 1;
    }
    const kept_hit_t farthest = heap[0];
    if (comes_first(&hit, &farthest)) {
        sink_hit(heap, count, 0, hit);
    }
    return count;
}

// Adds a crossing between the ray's t_min and t_max to the answer.
INLINED void add_crossing(search_t *search, const crossing_t crossing, const int query)
{
    if (query == QUERY_CLOSEST) {
        if (is_nearer(&crossing, &search->nearest)) {
            search->nearest = crossing;
        }
    } else if (query == QUERY_COUNT) {
        // A complete count still gets the rest of a leaf.
        if (search->count < search->max_count) {
            search->nearest = crossing;
            search->count++;
        }
    } else if (query == QUERY_PARITY) {
        const int prim_id = crossing.prim_id;
        search->count += !(search->surplus && (search->surplus[prim_id >> 5] >> (prim_id & 31) & 1));
    } else {
        search->count = keep_first(search->heap, search->count, search->max_count, as_kept_hit(search, &crossing));
    }
}
