// A tile of one work-item, see tree/tile.cl: eight clusters at a time in a vector.

#define ROW 8
typedef float8 row_t __attribute__((aligned(4)));
typedef int8 int_row_t __attribute__((aligned(4)));

// Clusters beyond the last one are read, too; and distances before the first.
#define ROOM (TILE_SIZE + 2 * ROW)
#define FAR 0x1p60f

typedef struct {
    float lower[3][ROOM];
    float upper[3][ROOM];
    int clusters[ROOM];
    int partners[ROOM];
    int distances[RADIUS][ROW + ROOM];
} tile_memory_t;

INLINED row_t load_row(const float *from)
{
    return *(const row_t *)from;
}

INLINED void set_box(tile_memory_t *tile, const int place, const float3 lower, const float3 upper)
{
    tile->lower[0][place] = lower.x;
    tile->lower[1][place] = lower.y;
    tile->lower[2][place] = lower.z;
    tile->upper[0][place] = upper.x;
    tile->upper[1][place] = upper.y;
    tile->upper[2][place] = upper.z;
}

INLINED box_t get_box(const tile_memory_t *tile, const int place)
{
    const box_t box = {
        (float3)(tile->lower[0][place], tile->lower[1][place], tile->lower[2][place]),
        (float3)(tile->upper[0][place], tile->upper[1][place], tile->upper[2][place])};
    return box;
}

INLINED row_t extent_of_both(const tile_memory_t *tile, const int axis, const int one, const int other)
{
    const row_t lower = load_row(tile->lower[axis] + one);
    const row_t other_lower = load_row(tile->lower[axis] + other);
    const row_t upper = load_row(tile->upper[axis] + one);
    const row_t other_upper = load_row(tile->upper[axis] + other);
    return (upper > other_upper ? upper : other_upper) - (lower < other_lower ? lower : other_lower);
}

// Set the partner of each cluster to its nearest neighbour.
INLINED void find_partners(tile_memory_t *tile, const int count)
{
    // What lies beyond is farther than anything.
    for (int place = count; place < count + ROW + RADIUS; place++) {
        set_box(tile, place, (float3)(-FAR), (float3)(FAR));
    }
    const int8 lanes = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    for (int first = 0; first < count; first += ROW) {
        for (int step = 1; step <= RADIUS; step++) {
            const row_t x = extent_of_both(tile, 0, first, first + step);
            const row_t y = extent_of_both(tile, 1, first, first + step);
            const row_t z = extent_of_both(tile, 2, first, first + step);
            const row_t area = ((LEAST_AREA + x * y) + y * z) + z * x;
            const int8 tag = ((first + lanes) ^ (first + step + lanes)) & TAG_MASK;
            *(int_row_t *)(tile->distances[step - 1] + ROW + first) = (as_int8(area) & ~TAG_MASK) | tag;
        }
    }
    for (int first = 0; first < count; first += ROW) {
        int8 least = INT_MAX;
        for (int step = 1; step <= RADIUS; step++) {
            const int8 ahead = *(const int_row_t *)(tile->distances[step - 1] + ROW + first);
            const int8 behind = *(const int_row_t *)(tile->distances[step - 1] + ROW + first - step);
            least = ahead < least ? ahead : least;
            least = behind < least ? behind : least;
        }
        // As in partner_of.
        const int8 place = first + lanes;
        const int8 steps = ((place ^ least) - place) & TAG_MASK;
        *(int_row_t *)(tile->partners + first) = place + steps - ((steps & (TAG_MASK / 2 + 1)) << 1);
    }
}

INLINED void pair_neighbours(tile_memory_t *tile, const int count)
{
    for (int place = 0; place < count; place++) {
        tile->partners[place] = (place ^ 1) < count ? place ^ 1 : place;
    }
}

// Merge the clusters of a tile, and write those that are left.
INLINED void merge_tile(
    const tree_t *tree, const tile_range_t *range, const global int *clusters, global int *left_over,
    const int tile_number)
{
    tile_memory_t tile;
    int count = range->count;
    int height = 0;
    for (int place = 0; place < count; place++) {
        const int cluster = clusters == 0 ? ~(range->begin + place) : clusters[range->begin + place];
        const box_t box = box_of_cluster(tree, cluster);
        set_box(&tile, place, box.lower, box.upper);
        tile.clusters[place] = cluster;
        height = max(height, is_single(cluster) ? 0 : tree->merges[cluster].height);
    }
    for (int step = 0; step < RADIUS; step++) {
        *(int_row_t *)tile.distances[step] = (int8)INT_MAX;
    }

    int merge = range->first_merge;
    for (int round = 0; count > range->target; round++) {
        if (is_late(range, round, count, height)) {
            pair_neighbours(&tile, count);
        } else {
            find_partners(&tile, count);
        }
        // The merge takes the place of the first of both; the last round makes no more merges than are wanted.
        const int last_merge = merge + count - range->target;
        int next = 0;
        for (int place = 0; place < count; place++) {
            const int partner = tile.partners[place];
            if (partner < 0) {
                continue;
            }
            int cluster = tile.clusters[place];
            box_t box = get_box(&tile, place);
            if (place < partner && tile.partners[partner] == place && merge < last_merge) {
                const box_t other = get_box(&tile, partner);
                height = max(height, merge_clusters(tree, merge, cluster, tile.clusters[partner], box, other));
                cluster = merge;
                box = unite(box, other);
                tile.partners[partner] = -1;
                merge++;
            }
            set_box(&tile, next, box.lower, box.upper);
            tile.clusters[next] = cluster;
            next++;
        }
        count = next;
    }
    for (int place = 0; place < count; place++) {
        left_over[range->target * tile_number + place] = tile.clusters[place];
    }
}
