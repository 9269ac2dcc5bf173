// The state of a query during a traversal. Every layout reports each crossing once, by `add_crossing`; the query
// decides whether it is kept, and how far the traversal has to go on.
//
// The query is a constant wherever these functions are called, so inlining removes the code of the others.
//
// HAS_SPHERES, if defined as 1: the primitives may be spheres, and `kind` says whether they are. make_search leaves it
// at triangles.

#include "hits/crossing.cl"
#include "rays/ray.cl"

// The nearest crossing. Ties go to the smaller prim_id, so the order of the tests does not matter.
#define QUERY_CLOSEST 0
// The number of crossings up to `max_count`; any hit is a count up to 1.
#define QUERY_COUNT 1
// The first `max_count` crossings along the ray, in `heap`.
#define QUERY_FIRST 2

typedef struct {
    crossing_t nearest;  // the nearest crossing; of a count, the last one
    int count;
    int max_count;       // at least 1
    global hit_t *heap;  // [max_count]: binary heap with the farthest hit on top
#if HAS_SPHERES
    int kind;            // KIND_TRIANGLES or KIND_SPHERES: the primitives of the tree that is traversed
#endif
} search_t;

INLINED search_t make_search(const int max_count, global hit_t *heap)
{
    const search_t search = {no_crossing(), 0, max_count, heap};
    return search;
}

// Whether no further crossing can change the answer.
INLINED bool is_complete(const search_t *search, const int query)
{
    return query == QUERY_COUNT && search->count >= search->max_count;
}

// The largest t at which a crossing can still change the answer.
INLINED float search_limit(const search_t *search, const ray_t *ray, const int query)
{
    if (query == QUERY_CLOSEST) {
        return smaller(search->nearest.t, ray->t_max);
    }
    return query == QUERY_FIRST && search->count >= search->max_count ? search->heap[0].t : ray->t_max;
}

// The order of hits along a ray.
INLINED bool comes_first(const hit_t *a, const hit_t *b)
{
#if HAS_SPHERES
    // A ray enters a sphere before it leaves it, also where float32 has one t for both.
    if (a->t == b->t && a->prim_id == b->prim_id) {
        return a->u < b->u;
    }
#endif
    return a->t < b->t || (a->t == b->t && a->prim_id < b->prim_id);
}

// Replaces the hit in a slot; it moves down until none of its children is farther (Williams, "Heapsort", 1964).
INLINED void sink_hit(global hit_t *heap, const int count, int slot, const hit_t hit)
{
    for (int child = 2 * slot + 1; child < count; child = 2 * slot + 1) {
        hit_t farther = heap[child];
        if (child + 1 < count) {
            const hit_t other = heap[child + 1];
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
INLINED void append_hit(global hit_t *heap, int slot, const hit_t hit)
{
    while (slot > 0) {
        const hit_t parent = heap[(slot - 1) / 2];
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
        const hit_t last = search->heap[end];
        search->heap[end] = search->heap[0];
        sink_hit(search->heap, end, 0, last);
    }
}

// Adds a crossing between the ray's t_min and t_max to the answer.
INLINED void add_crossing(search_t *search, const crossing_t crossing, const int query)
{
    if (query == QUERY_CLOSEST) {
        const hit_t hit = as_hit(&crossing);
        const hit_t nearest = as_hit(&search->nearest);
        if (comes_first(&hit, &nearest)) {
            search->nearest = crossing;
        }
    } else if (query == QUERY_COUNT) {
        // A complete count still gets the rest of a leaf.
        if (search->count < search->max_count) {
            search->nearest = crossing;
            search->count++;
        }
    } else if (search->count < search->max_count) {
        append_hit(search->heap, search->count++, as_hit(&crossing));
    } else {
        const hit_t hit = as_hit(&crossing);
        const hit_t farthest = search->heap[0];
        if (comes_first(&hit, &farthest)) {
            sink_hit(search->heap, search->count, 0, hit);
        }
    }
}
