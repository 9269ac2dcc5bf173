// A batch of rays in memory: one work-item per ray, one work-group per tile.
//
// A batch has rows of `row_length` rays. The rays of a picture keep its rows, and tiles are rectangles of pixels; any
// other batch is a single row, and a tile is a piece of it.
//
// order[ray_count]     ray_id of each ray: its number on the host, which is the index of its results. Neighbours in the
//                      batch should be close together in space, see clbvh/trace/rays/coherence.py. NULL: the identity
//
// Work-items: (row_length, rows), rounded up to whole tiles.

#include "rays/ray.cl"

// The ray_id of work-items beyond the edges of the batch.
#define NO_RAY -1

// Returns the index in the batch of a work-item's ray, or NO_RAY beyond the edges of the batch. Kernels alone ask for
// the numbers of their work-item: those of the host have them as an argument.
INLINED int find_ray_index(const int column, const int row, const int ray_count, const int row_length)
{
    const int ray_index = row * row_length + column;
    return column >= row_length || ray_index >= ray_count ? NO_RAY : ray_index;
}

// The index of this work-item's tile; for kernels.
#define TILE_INDEX ((int)(get_group_id(1) * get_num_groups(0) + get_group_id(0)))
