// One tile of clusters: rounds in which nearest neighbours merge, until a given number is left (PLOC: Meister and
// Bittner, "Parallel locally-ordered clustering for bounding volume hierarchy construction", 2018; in tiles: Benthin et
// al., "H-PLOC", 2024).
//
// GROUPED as 1: a work-group of GROUP_SIZE items has a tile, in local memory. As 0: one work-item has it, with the
// clusters in vectors and without a barrier; CPUs are faster so. Both make the same tree.

#include "tree/merges.cl"

#define TILE_SIZE 512
#define RADIUS 4

// More rounds than any mesh needs that is not made to need them, and the greatest height of a tree, `MAX_DEPTH` of
// `builders/options.py`. From there on neighbours are paired, whatever their distance.
#define MOST_ROUNDS 40
#define MOST_HEIGHT 64

// A tile of a pass over all clusters.
//
// begin, count   its clusters
// target         clusters that are left of it
// first_merge    number of its first merge
// levels_above   height that the passes after this one add at least
typedef struct {
    int begin;
    int count;
    int target;
    int first_merge;
    int levels_above;
} tile_range_t;

INLINED tile_range_t find_tile(
    const int tile, const int cluster_count, const int tile_count, const int target, const int first_merge,
    const int levels_above)
{
    const int size = cluster_count / tile_count;
    const int larger_tiles = cluster_count % tile_count;
    const int begin = size * tile + min(tile, larger_tiles);
    const tile_range_t range = {
        begin, size + (tile < larger_tiles), target, first_merge + begin - target * tile, levels_above};
    return range;
}

// The distance between clusters is the area of the box around both: as an integer that orders like it, whose lowest
// bits say which two clusters they are. So no two distances of a cluster are equal, and of many equal areas those of
// the pairs (0, 1), (2, 3), ... are the least: identical triangles would otherwise take a round for each merge. What is
// added absorbs numbers below the normal ones, which some devices flush to zero.
#define TAG_BITS 4
#define TAG_MASK ((1 << TAG_BITS) - 1)
#define LEAST_AREA 0x1p-100f

// The neighbour whose place differs from a cluster's as the tag says: it is at most RADIUS places away.
INLINED int partner_of(const int place, const int distance)
{
    const int ahead = ((place ^ distance) - place) & TAG_MASK;
    return place + ahead - (ahead > TAG_MASK / 2 ? TAG_MASK + 1 : 0);
}

// Whether neighbours have to be paired, so that the tree does not become too high.
INLINED bool is_late(const tile_range_t *range, const int round, const int count, const int height)
{
    int levels = range->levels_above;
    for (int width = range->target; width < count; width *= 2) {
        levels++;
    }
    return round >= MOST_ROUNDS || height + levels >= MOST_HEIGHT;
}

// keep: one of them has merge_tile
#if GROUPED
#include "tree/tile_group.cl"
#else
#include "tree/tile_item.cl"
#endif
