// Where the rays of each tile of a batch enter the tree: one work-item for each tile.
//
// nodes[node_count]                              the tree, see clbvh/layout.py
// rays[ray_count]                                object units, relative to the mesh's origin
// width                                          rays in a row, see cl/batch.cl
// tile_width, tile_height                        the work-groups of the kernels that trace the rays
// entries[tile_rows * tile_columns]              written
//
// Work-items: (tile_columns, tile_rows).

#include "entry.cl"

#if HAS_ENTRIES

kernel void tile_entries(
    const global node_t *restrict nodes, const global ray_t *restrict rays, const int ray_count, const int width,
    const int tile_width, const int tile_height, global node_t *restrict entries)
{
    const int tile_columns = (width + tile_width - 1) / tile_width;
    const int first_column = tile_width * get_global_id(0);
    const int first_row = tile_height * get_global_id(1);
    if (first_column >= width || first_row * width >= ray_count) {
        return;
    }
    const int column_count = min(tile_width, width - first_column);
    const int row_count = min(tile_height, (ray_count - first_row * width + width - 1) / width);
    global node_t *entry = entries + get_global_id(1) * tile_columns + get_global_id(0);

    ray_bounds_t bounds = no_rays();
    for (int row = first_row; row < first_row + row_count; row++) {
        for (int column = first_column; column < first_column + column_count; column++) {
            if (row * width + column < ray_count) {
                include_ray(&bounds, ((const global float8 *)rays)[row * width + column]);
            }
        }
    }
    find_entry(nodes, &bounds, entry);
}

#endif
