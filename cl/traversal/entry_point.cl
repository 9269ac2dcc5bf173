// Entry points: the rays of a tile begin at a node of their own instead of at the root. Its children are the few
// subtrees that the tile's beam meets (Reshetov, Soupikov and Hurley, "Multi-level ray tracing algorithm", 2005).
//
// An entry point without children: the tile's rays hit nothing. An entry point whose first child is ROOT, which is no
// node's child: the tile's rays begin at the root.
//
// Entry points exist in the layouts with HAS_ENTRY_POINTS, see traversal/traverse.cl.

#include "traversal/traverse.cl"

#define ROOT 0
#define NO_CHILD -1

// The node at which the rays of a tile begin; the root if `entry_points` is NULL.
INLINED const global node_t *find_start_node(
    const global node_t *nodes, const global node_t *entry_points, const int tile_index)
{
#if HAS_ENTRY_POINTS
    if (entry_points) {
        const global node_t *entry_point = entry_points + tile_index;
        return entry_point->child[0] == ROOT ? nodes : entry_point;
    }
#endif
    return nodes;
}

// Whether no ray that begins at a node can hit anything.
INLINED bool node_meets_nothing(const global node_t *start)
{
#if HAS_ENTRY_POINTS
    return !has_children(start);
#else
    return false;
#endif
}

#if HAS_ENTRY_POINTS

#include "boxes/beam.cl"

// A beam that meets more children of the root begins there, because an entry point would gain little. On the dragon and
// the bunny, limits of 4, 6 and 8 of 8 children are equally fast for pictures; rays in any order lose 3 to 4 % with 4,
// and 7 % with 8.
#define MAX_ROOT_CHILDREN (WIDTH / 2)

// Writes a child with an inverted box, which no ray meets.
INLINED void clear_child(global node_t *entry_point, const int slot, const int child)
{
    for (int axis = 0; axis < 3; axis++) {
        entry_point->aabb_min[axis][slot] = FLT_MAX;
        entry_point->aabb_max[axis][slot] = -FLT_MAX;
    }
    entry_point->child[slot] = child;
}

// The children of an entry point, each by its parent in the tree.
typedef struct {
    int parent[WIDTH];  // index of a node
    int lane[WIDTH];    // the child's lane in the parent
    int child[WIDTH];   // the parent's `child` in that lane: a node or a block
    int count;
} frontier_t;

// Replaces a node in the frontier by its children that are met: the first takes the slot, the others are appended. If
// none is met, the last child of the frontier takes the slot. Assumes that there is room.
INLINED void replace_node(
    frontier_t *frontier, const int slot, const global node_t *nodes, const int node, uint met)
{
    if (met == 0) {
        const int last = --frontier->count;
        frontier->parent[slot] = frontier->parent[last];
        frontier->lane[slot] = frontier->lane[last];
        frontier->child[slot] = frontier->child[last];
        return;
    }
    int free_slot = slot;
    for (; met != 0; met &= met - 1) {
        const int lane = lowest_bit(met);
        frontier->parent[free_slot] = node;
        frontier->lane[free_slot] = lane;
        frontier->child[free_slot] = nodes[node].child[lane];
        free_slot = max(free_slot + 1, frontier->count);
    }
    frontier->count = free_slot;
}

// Replaces nodes by their children that the beam meets, as long as there is room.
INLINED void descend(frontier_t *frontier, const global node_t *nodes, const beam_t *beam)
{
    int slot = 0;
    while (slot < frontier->count) {
        const int node = frontier->child[slot];
        if (node < 0) {
            slot++;
            continue;
        }
        const uint met = beam_meets_children(nodes + node, beam);
        if (frontier->count - 1 + (int)popcount(met) > WIDTH) {
            slot++;
        } else {
            replace_node(frontier, slot, nodes, node, met);
        }
    }
}

INLINED void write_entry_point(const frontier_t *frontier, const global node_t *nodes, global node_t *entry_point)
{
    for (int i = 0; i < WIDTH; i++) {
        if (i >= frontier->count) {
            clear_child(entry_point, i, NO_CHILD);
            continue;
        }
        const global node_t *parent = nodes + frontier->parent[i];
        for (int axis = 0; axis < 3; axis++) {
            entry_point->aabb_min[axis][i] = parent->aabb_min[axis][frontier->lane[i]];
            entry_point->aabb_max[axis][i] = parent->aabb_max[axis][frontier->lane[i]];
        }
        entry_point->child[i] = frontier->child[i];
    }
}

// Finds the entry point of a tile from the bounds of its rays.
INLINED void find_entry_point(
    const global node_t *nodes, const ray_bounds_t *bounds, global node_t *entry_point)
{
    const beam_t beam = make_beam(bounds);
    if (beam.is_empty) {
        clear_child(entry_point, 0, NO_CHILD);
        return;
    }
    const uint met = beam.is_unbounded ? ~0u : beam_meets_children(nodes, &beam);
    if (popcount(met) > MAX_ROOT_CHILDREN) {
        clear_child(entry_point, 0, ROOT);
        return;
    }
    frontier_t frontier = {.count = 1};
    replace_node(&frontier, 0, nodes, ROOT, met);
    descend(&frontier, nodes, &beam);
    write_entry_point(&frontier, nodes, entry_point);
}

#endif
