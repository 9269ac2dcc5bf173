// Where the rays of a tile enter the tree: the few subtrees that its beam meets, side by side as the children of a node
// that is the tile's own. Its rays begin there instead of at the root (Reshetov, Soupikov and Hurley, "Multi-level ray
// tracing algorithm", 2005).
//
// An entry without children: the tile's rays hit nothing. One that leads to the root, which is nobody's child: they have
// to begin there.

#include "batch.cl"
#include "traverse.cl"

#define ROOT 0
#define NOTHING -1

// The node at which this work-item's ray begins. Some layouts have no entries.
INLINED const global node_t *find_start(const global node_t *nodes, const global node_t *entries)
{
#if HAS_ENTRIES
    if (entries) {
        const global node_t *entry = entries + tile_of_ray();
        return entry->child[0] == ROOT ? nodes : entry;
    }
#endif
    return nodes;
}

#if HAS_ENTRIES

#include "beam.cl"

// A beam that meets more children of the root has little to gain from a search. At the dragon and the bunny 4, 6 and 8 of
// 8 are equally fast for pictures; rays in any order lose 3 to 4 % with 4, and 7 % with 8.
#define MOST_OF_ROOT (WIDTH / 2)

INLINED void mark_child(global node_t *entry, const int place, const int child)
{
    for (int axis = 0; axis < 3; axis++) {
        entry->aabb_min[axis][place] = FLT_MAX;
        entry->aabb_max[axis][place] = -FLT_MAX;
    }
    entry->child[place] = child;
}

// From the root down, nodes are replaced by those of their children that the beam meets, as long as there is room.
INLINED void write_entry(const global node_t *nodes, const beam_t *beam, global node_t *entry)
{
    // Where the entry's children stand, as children of nodes.
    int owner[WIDTH];
    int lane_in_owner[WIDTH];
    int child[WIDTH];
    child[0] = ROOT;
    int count = 1;
    int place = 0;
    while (place < count) {
        const int node = child[place];
        uint met = node >= 0 ? beam_meets_children(nodes + node, beam) : 0;
        const int more = popcount(met);
        if (node < 0 || count - 1 + more > WIDTH) {
            place++;
            continue;
        }
        if (met == 0) {
            count--;
            owner[place] = owner[count];
            lane_in_owner[place] = lane_in_owner[count];
            child[place] = child[count];
            continue;
        }
        for (int to = place; met != 0; met &= met - 1) {
            const int lane = lowest_bit(met);
            owner[to] = node;
            lane_in_owner[to] = lane;
            child[to] = nodes[node].child[lane];
            to = to == place ? count : to + 1;
        }
        count += more - 1;
    }

    for (int i = 0; i < WIDTH; i++) {
        if (i >= count) {
            mark_child(entry, i, NOTHING);
            continue;
        }
        const global node_t *from = nodes + owner[i];
        for (int axis = 0; axis < 3; axis++) {
            entry->aabb_min[axis][i] = from->aabb_min[axis][lane_in_owner[i]];
            entry->aabb_max[axis][i] = from->aabb_max[axis][lane_in_owner[i]];
        }
        entry->child[i] = child[i];
    }
}

INLINED void find_entry(const global node_t *nodes, const ray_bounds_t *bounds, global node_t *entry)
{
    const beam_t beam = make_beam(bounds);
    if (beam.is_empty) {
        mark_child(entry, 0, NOTHING);
    } else if (beam.is_anything || popcount(beam_meets_children(nodes, &beam)) > MOST_OF_ROOT) {
        mark_child(entry, 0, ROOT);
    } else {
        write_entry(nodes, &beam, entry);
    }
}

#endif
