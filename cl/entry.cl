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

// The children of an entry, by where they stand in the tree.
typedef struct {
    int owner[WIDTH];  // a node, and
    int lane[WIDTH];   // which of its children
    int child[WIDTH];  // what the owner says of it
    int count;
} frontier_t;

// Puts the children of a node that are met in its place, for which there is room; without any, the last child of the entry.
INLINED void replace_node(frontier_t *frontier, const int place, const global node_t *nodes, const int node, uint met)
{
    if (met == 0) {
        const int last = --frontier->count;
        frontier->owner[place] = frontier->owner[last];
        frontier->lane[place] = frontier->lane[last];
        frontier->child[place] = frontier->child[last];
        return;
    }
    int to = place;
    for (; met != 0; met &= met - 1) {
        const int lane = lowest_bit(met);
        frontier->owner[to] = node;
        frontier->lane[to] = lane;
        frontier->child[to] = nodes[node].child[lane];
        to = max(to + 1, frontier->count);
    }
    frontier->count = to;
}

// From the root down, nodes are replaced by those of their children that the beam meets, as long as there is room.
INLINED void descend(frontier_t *frontier, const global node_t *nodes, const beam_t *beam)
{
    int place = 0;
    while (place < frontier->count) {
        const int node = frontier->child[place];
        if (node < 0) {
            place++;
            continue;
        }
        const uint met = beam_meets_children(nodes + node, beam);
        if (frontier->count - 1 + (int)popcount(met) > WIDTH) {
            place++;
        } else {
            replace_node(frontier, place, nodes, node, met);
        }
    }
}

INLINED void write_entry(const frontier_t *frontier, const global node_t *nodes, global node_t *entry)
{
    for (int i = 0; i < WIDTH; i++) {
        if (i >= frontier->count) {
            mark_child(entry, i, NOTHING);
            continue;
        }
        const global node_t *from = nodes + frontier->owner[i];
        for (int axis = 0; axis < 3; axis++) {
            entry->aabb_min[axis][i] = from->aabb_min[axis][frontier->lane[i]];
            entry->aabb_max[axis][i] = from->aabb_max[axis][frontier->lane[i]];
        }
        entry->child[i] = frontier->child[i];
    }
}

INLINED void find_entry(const global node_t *nodes, const ray_bounds_t *bounds, global node_t *entry)
{
    const beam_t beam = make_beam(bounds);
    if (beam.is_empty) {
        mark_child(entry, 0, NOTHING);
        return;
    }
    const uint met = beam.is_anything ? ~0u : beam_meets_children(nodes, &beam);
    if (popcount(met) > MOST_OF_ROOT) {
        mark_child(entry, 0, ROOT);
        return;
    }
    frontier_t frontier = {.count = 1};
    replace_node(&frontier, 0, nodes, ROOT, met);
    descend(&frontier, nodes, &beam);
    write_entry(&frontier, nodes, entry);
}

#endif
