// Where the rays of a tile begin in a scene.
//
// The beam of a tile's rays meets few instances, or none. Their leaves are listed, so that its rays need not find them
// in the tree over the instances; and of a single instance, its rays begin at an entry point of the geometry's tree.
//
// tiles[tile_count]            tile_t: see instances/entry_point.cl, which finds them. NULL: all rays begin at
//                              the root
// entry_points[tile_count]     node_t: see traversal/entry_point.cl; written for tiles with an instance_index only

#include "traversal/traverse.cl"

#define NO_INSTANCE -1

// The leaf_count of a tile whose rays begin at a node of the tree over the instances.
#define NO_LIST -1

typedef struct {
    const global tile_t *tile;   // lists the leaves; NULL if the tree is traversed
    int top_node;                      // where that begins
    int instance_index;                // the only instance that is visited, untested; or NO_INSTANCE
    const global node_t *entry_point;  // of that instance; NULL: the root
} instance_start_t;

INLINED instance_start_t start_at_root(void)
{
    const instance_start_t start = {0, 0, NO_INSTANCE, 0};
    return start;
}

// The start of the rays of a tile.
INLINED instance_start_t find_instance_start(
    const global tile_t *tiles, const global node_t *entry_points, const int index)
{
    instance_start_t start = start_at_root();
#if HAS_ENTRY_POINTS
    if (tiles) {
        const global tile_t *tile = tiles + index;
        start.tile = tile->leaf_count == NO_LIST ? 0 : tile;
        start.top_node = tile->top_node;
        start.instance_index = tile->instance_index;
        start.entry_point = tile->instance_index == NO_INSTANCE ? 0 : entry_points + index;
    }
#endif
    return start;
}
