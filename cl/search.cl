// What a query makes of the crossings that a traversal comes across. Every layout reports each crossing once, by
// `note_crossing`; which query it is decides what is remembered, and how far the traversal has to go on.
//
// The query is a constant wherever these functions are called: a compiler that inlines leaves nothing of the others.

#include "crossing.cl"
#include "ray.cl"

// The nearest crossing. Ties go to the smaller face number, so the order of the tests does not matter.
#define QUERY_CLOSEST 0
// How many crossings there are; `most` of them suffice, so any hit is a count up to 1.
#define QUERY_COUNT 1
// The `most` nearest crossings, into `kept`.
#define QUERY_KEEP 2

typedef struct {
    crossing_t nearest;  // of a count: the last one
    int count;
    int most;            // at least 1
    global hit_t *kept;  // [most]; a heap with the farthest hit on top
} search_t;

INLINED search_t begin_search(const int most, global hit_t *kept)
{
    const search_t search = {no_crossing(), 0, most, kept};
    return search;
}

// Whether no further crossing can change the answer.
INLINED bool is_settled(const search_t *search, const int query)
{
    return query == QUERY_COUNT && search->count >= search->most;
}

// How far along the ray a crossing can still change the answer.
INLINED float search_limit(const search_t *search, const path_t *path, const int query)
{
    if (query == QUERY_CLOSEST) {
        return smaller(search->nearest.t, path->t_max);
    }
    return query == QUERY_KEEP && search->count >= search->most ? search->kept[0].t : path->t_max;
}

// The order of hits along a ray.
INLINED bool is_before(const hit_t *a, const hit_t *b)
{
    return a->t < b->t || (a->t == b->t && a->prim_id < b->prim_id);
}

// Put a hit where kept[place] was, which moves down until no hit below it is farther (Williams, "Heapsort", 1964).
INLINED void sink_hit(global hit_t *kept, const int count, int place, const hit_t hit)
{
    for (int below = 2 * place + 1; below < count; below = 2 * place + 1) {
        hit_t farther = kept[below];
        if (below + 1 < count) {
            const hit_t other = kept[below + 1];
            if (is_before(&farther, &other)) {
                farther = other;
                below++;
            }
        }
        if (!is_before(&hit, &farther)) {
            break;
        }
        kept[place] = farther;
        place = below;
    }
    kept[place] = hit;
}

// Put a hit behind the others, and move it up until the one above is farther.
INLINED void append_hit(global hit_t *kept, int place, const hit_t hit)
{
    while (place > 0) {
        const hit_t above = kept[(place - 1) / 2];
        if (!is_before(&above, &hit)) {
            break;
        }
        kept[place] = above;
        place = (place - 1) / 2;
    }
    kept[place] = hit;
}

// Bring the kept hits into the order along the ray.
INLINED void sort_hits(const search_t *search)
{
    for (int end = search->count - 1; end > 0; end--) {
        const hit_t last = search->kept[end];
        search->kept[end] = search->kept[0];
        sink_hit(search->kept, end, 0, last);
    }
}

// Takes a crossing into account. It lies between the ray's t_min and t_max.
INLINED void note_crossing(search_t *search, const crossing_t crossing, const int query)
{
    if (query == QUERY_CLOSEST) {
        const hit_t hit = as_hit(&crossing);
        const hit_t nearest = as_hit(&search->nearest);
        if (is_before(&hit, &nearest)) {
            search->nearest = crossing;
        }
    } else if (query == QUERY_COUNT) {
        // The rest of a leaf is still tested when the count is full.
        if (search->count < search->most) {
            search->nearest = crossing;
            search->count++;
        }
    } else if (search->count < search->most) {
        append_hit(search->kept, search->count++, as_hit(&crossing));
    } else {
        const hit_t hit = as_hit(&crossing);
        const hit_t farthest = search->kept[0];
        if (is_before(&hit, &farthest)) {
            sink_hit(search->kept, search->count, 0, hit);
        }
    }
}
