// All hits of rays, for clbvh/trace/hits/all_hits.py: those that the device found are compacted, and refined.

#include "structs.cl"
#include "hits/found.cl"
#include "hits/locations.cl"
#include "hits/refine.cl"
#include "hits/surfaces.cl"
#include "rays/arrays.cl"
#include "rays/given.cl"

// How many rays ahead their counts and their hits are asked for.
#define RAYS_AHEAD 16

// How many hits ahead corners are asked for; 8 to 16 perform alike.
#define CORNERS_AHEAD 12

// Hits that are listed at a time.
#define LISTED_HITS 128

// The source of a ray's hits: the number of a segment, and the offset in it in this many bits. As in `OFFSET_BITS`.
#define OFFSET_BITS 40
#define OFFSET_MASK ((1L << OFFSET_BITS) - 1)

// A hit of either kind as 8-byte words: the primitive is the upper half of this one.
#define PRIM_WORD 1

static int prim_of_words(const long *words)
{
    return (int)(words[PRIM_WORD] >> 32);
}

// Copies the hits before the first miss of each ray, one behind the other. Rays whose slots are all taken are listed
// instead, unless `is_enough`. Returns the number of hits copied.
//
// kept[ray_count][slots][words]    what the device found
// ray_ids[ray_count]  the numbers of the rays
// segment             of the hits, in the upper bits
// crowded[ray_count]  written: rays whose slots are all taken; and in crowded_count[1] how many there are
// counts[], sources[] written, by the numbers of rays
loop long compact(
    const long *kept, const long slots, const long words, const long ray_count, const int ray_ids[ray_count],
    const bool is_enough, const long segment, long *hits, int crowded[ray_count], long crowded_count[1], int *counts,
    long *sources)
{
    long hit_count = 0;
    crowded_count[0] = 0;
    for (long ray = 0; ray < ray_count; ray++) {
        const int coming = ray_ids[min(ray + RAYS_AHEAD, ray_count - 1)];
        WILL_WRITE(counts + coming);
        WILL_WRITE(sources + coming);
        const long *own = kept + ray * slots * words;
        long count = 0;
        while (count < slots && prim_of_words(own + count * words) != NO_PRIM) {
            count++;
        }
        if (count == 0) {
            continue;
        }
        if (count == slots && !is_enough) {
            crowded[crowded_count[0]++] = ray_ids[ray];
            continue;
        }
        counts[ray_ids[ray]] = (int)count;
        sources[ray_ids[ray]] = segment | hit_count;
        for (long word = 0; word < count * words; word++) {
            hits[hit_count * words + word] = own[word];
        }
        hit_count += count;
    }
    return hit_count;
}

static long source_index(const long source, const long *segment_begins)
{
    return segment_begins[source >> OFFSET_BITS] + (source & OFFSET_MASK);
}

// Refines the hits of rays, and writes them from a slot on; returns the slot behind them. On a lone shape, no t is
// smaller than that of the hit before it on the ray.
//
// arrays              `SurfaceArrays.addresses`
// rays, first_ray     see cl/rays/given.cl
// found, found_in_world    one of both: the hits of all segments
// segment_begins[], counts[ray_count], sources[ray_count]    see `Crossings`
// t[], ..., instance_id[]  written; the last of worlds with instances alone
// locations[][3]      written, in world coordinates, unless NULL
loop long refine_rays(
    const ulong *arrays, const ulong *rays, const long first_ray, const hit_t *found, const world_hit_t *found_in_world,
    const long *segment_begins, const long ray_count, const int counts[ray_count], const long sources[ray_count],
    const long first_slot, double *t, double *u, double *v, bool *is_front, int *prim_id, int *instance_id,
    double *locations)
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    const given_rays_t given = rays_from(rays, first_ray);
    const found_hits_t hits = {found, found_in_world};
    long listed_rays[LISTED_HITS], listed[LISTED_HITS];
    long slot = first_slot, ray = 0, ray_before = -1;
    int depth = 0;
    while (ray < ray_count) {
        int count = 0;
        while (ray < ray_count && count < LISTED_HITS) {
            if (depth == counts[ray]) {
                ray++;
                depth = 0;
                if (ray + RAYS_AHEAD < ray_count) {
                    will_read_found(&hits, source_index(sources[ray + RAYS_AHEAD], segment_begins));
                }
                continue;
            }
            listed_rays[count] = ray;
            listed[count] = source_index(sources[ray], segment_begins) + depth;
            count++;
            depth++;
        }
        for (int index = 0; index < count; index++) {
            will_read_prim(&surfaces, &hits, listed[index]);
        }
        for (int index = 0; index < count; index++, slot++) {
            will_read_corners(&surfaces, &hits, listed[min(index + CORNERS_AHEAD, count - 1)]);
            const int prim = prim_of(&hits, listed[index]), instance = instance_of(&hits, listed[index]);
            const wide_ray_t of_hit = read_ray(&given, listed_rays[index]);
            const refined_hit_t hit =
                refine_hit(&surfaces, &of_hit, instance, prim, is_leaving(&hits, listed[index]));
            const bool is_next = surfaces.is_lone && listed_rays[index] == ray_before;
            ray_before = listed_rays[index];
            t[slot] = is_next ? max(hit.t, t[slot - 1]) : hit.t;
            u[slot] = hit.u;
            v[slot] = hit.v;
            is_front[slot] = hit.side > 0.0;
            prim_id[slot] = prim;
            if (found_in_world) {
                instance_id[slot] = instance;
            }
            if (locations) {
                vstore3(locate_point(&surfaces, instance, prim, hit.u, hit.v), slot, locations);
            }
        }
    }
    return slot;
}

// Raises each t to that of the hit before it on the ray.
loop void keep_order(const long count, const int counts[count], const long first_slot, double *t)
{
    long slot = first_slot;
    for (long ray = 0; ray < count; ray++) {
        for (int depth = 0; depth < counts[ray]; depth++, slot++) {
            if (depth > 0) {
                t[slot] = max(t[slot], t[slot - 1]);
            }
        }
    }
}

typedef struct {
    double coordinates[3];
} location_t;

// Moves an item to before those from `first` on.
#define MOVE(type) \
    static void move_##type(type *items, const long first, const long item) \
    { \
        const type moved = items[item]; \
        for (long slot = item; slot > first; slot--) { \
            items[slot] = items[slot - 1]; \
        } \
        items[first] = moved; \
    }
MOVE(double)
MOVE(int)
MOVE(bool)
MOVE(location_t)

// Sorts the hits of each ray by t; equal ones keep their order. Nearly all are in order already.
loop void sort_by_t(
    const long count, const int counts[count], const long first_slot, double *t, double *u, double *v, bool *is_front,
    int *prim_id, int *instance_id, double *locations)
{
    long begin = first_slot;
    for (long ray = 0; ray < count; ray++) {
        const long end = begin + counts[ray];
        for (long next = begin + 1; next < end; next++) {
            long slot = next;
            while (slot > begin && t[next] < t[slot - 1]) {
                slot--;
            }
            if (slot < next) {
                move_double(t, slot, next);
                move_double(u, slot, next);
                move_double(v, slot, next);
                move_bool(is_front, slot, next);
                move_int(prim_id, slot, next);
                move_int(instance_id, slot, next);
                if (locations) {
                    move_location_t((location_t *)locations, slot, next);
                }
            }
        }
        begin = end;
    }
}
