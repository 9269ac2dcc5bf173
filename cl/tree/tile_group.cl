// A tile of a work-group, see tree/tile.cl. Every item does the same steps for its own clusters, which are neighbours;
// all items reach all barriers.

// Clusters of an item.
#define OWN (TILE_SIZE / GROUP_SIZE)

typedef struct {
    float lower[3][TILE_SIZE];
    float upper[3][TILE_SIZE];
    int clusters[TILE_SIZE];
    int partners[TILE_SIZE];
    int sums[GROUP_SIZE];
    int height;
} tile_memory_t;

INLINED box_t get_box(const local tile_memory_t *tile, const int place)
{
    const box_t box = {
        (float3)(tile->lower[0][place], tile->lower[1][place], tile->lower[2][place]),
        (float3)(tile->upper[0][place], tile->upper[1][place], tile->upper[2][place])};
    return box;
}

INLINED void set_cluster(local tile_memory_t *tile, const int place, const int cluster, const box_t box)
{
    tile->lower[0][place] = box.lower.x;
    tile->lower[1][place] = box.lower.y;
    tile->lower[2][place] = box.lower.z;
    tile->upper[0][place] = box.upper.x;
    tile->upper[1][place] = box.upper.y;
    tile->upper[2][place] = box.upper.z;
    tile->clusters[place] = cluster;
}

INLINED int distance_of(const local tile_memory_t *tile, const int one, const int other)
{
    const box_t box = unite(get_box(tile, one), get_box(tile, other));
    const float3 size = box.upper - box.lower;
    const float area = ((LEAST_AREA + size.x * size.y) + size.y * size.z) + size.z * size.x;
    return (as_int(area) & ~TAG_MASK) | ((one ^ other) & TAG_MASK);
}

INLINED int nearest_neighbour(const local tile_memory_t *tile, const int place, const int count)
{
    int least = INT_MAX;
    for (int other = max(place - RADIUS, 0); other <= min(place + RADIUS, count - 1); other++) {
        if (other != place) {
            least = min(least, distance_of(tile, place, other));
        }
    }
    return partner_of(place, least);
}

// The sum of what the items before this one give.
INLINED int sum_before(local tile_memory_t *tile, const int own)
{
    const int item = (int)get_local_id(0);
    tile->sums[item] = own;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int step = 1; step < GROUP_SIZE; step <<= 1) {
        const int before = item >= step ? tile->sums[item - step] : 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        tile->sums[item] += before;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    return tile->sums[item] - own;
}

INLINED bool begins_pair(const local tile_memory_t *tile, const int place, const int count)
{
    return place < count && place < tile->partners[place] && tile->partners[tile->partners[place]] == place;
}

// Merge the clusters of a tile, and write those that are left.
INLINED void merge_tile(
    const tree_t *tree, const tile_range_t *range, const global int *clusters, global int *left_over,
    const int tile_number, local tile_memory_t *tile)
{
    const int item = (int)get_local_id(0);
    const int first = item * OWN;
    int count = range->count;
    if (item == 0) {
        tile->height = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int place = first; place < min(first + OWN, count); place++) {
        const int cluster = clusters == 0 ? ~(range->begin + place) : clusters[range->begin + place];
        set_cluster(tile, place, cluster, box_of_cluster(tree, cluster));
        if (!is_single(cluster)) {
            atomic_max(&tile->height, tree->merges[cluster].height);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    int merge = range->first_merge;
    for (int round = 0; count > range->target; round++) {
        const bool is_paired = is_late(range, round, count, tile->height);
        for (int place = first; place < min(first + OWN, count); place++) {
            const int neighbour = (place ^ 1) < count ? place ^ 1 : place;
            tile->partners[place] = is_paired ? neighbour : nearest_neighbour(tile, place, count);
        }
        barrier(CLK_LOCAL_MEM_FENCE);

        // The last round makes no more merges than are wanted.
        int pairs = 0;
        for (int place = first; place < first + OWN; place++) {
            pairs += begins_pair(tile, place, count);
        }
        const int first_number = merge + sum_before(tile, pairs);
        const int merge_count = min(tile->sums[GROUP_SIZE - 1], count - range->target);
        // A bit for each cluster that is the first of a pair that merges.
        uint made = 0;
        int number = first_number;
        for (int i = 0; i < OWN; i++) {
            const int place = first + i;
            if (begins_pair(tile, place, count) && number < merge + merge_count) {
                const int partner = tile->partners[place];
                const int height = merge_clusters(
                    tree, number, tile->clusters[place], tile->clusters[partner], get_box(tile, place),
                    get_box(tile, partner));
                atomic_max(&tile->height, height);
                made |= 1u << i;
                number++;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);

        // A pair is marked at its second cluster, which goes.
        for (int i = 0; i < OWN; i++) {
            if (made >> i & 1) {
                tile->partners[tile->partners[first + i]] = -1;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        int staying = 0;
        for (int place = first; place < min(first + OWN, count); place++) {
            staying += tile->partners[place] >= 0;
        }
        int next = sum_before(tile, staying);

        // The merge takes the place of the first of both. Without indices that vary, the arrays are registers.
        int new_clusters[OWN];
        box_t new_boxes[OWN];
        number = first_number;
#pragma unroll
        for (int i = 0; i < OWN; i++) {
            const int place = first + i;
            new_clusters[i] = tile->clusters[place];
            new_boxes[i] = get_box(tile, place);
            if (made >> i & 1) {
                new_clusters[i] = number++;
                new_boxes[i] = unite(new_boxes[i], get_box(tile, tile->partners[place]));
            }
        }
        // What this item has written, others read in the next round.
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
#pragma unroll
        for (int i = 0; i < OWN; i++) {
            if (first + i < count && tile->partners[first + i] >= 0) {
                set_cluster(tile, next++, new_clusters[i], new_boxes[i]);
            }
        }
        merge += merge_count;
        count -= merge_count;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    for (int place = first; place < min(first + OWN, count); place++) {
        left_over[range->target * tile_number + place] = tile->clusters[place];
    }
}
