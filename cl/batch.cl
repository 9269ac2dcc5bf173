// A batch of rays in memory, and the work-items for it. Rays that follow each other like the pixels of a picture, row by
// row, are taken tile by tile, each tile by one work-group; others are one row, and a tile is a part of it.

#include "ray.cl"

#define NO_RAY -1

// The place of this work-item's ray in the batch, or NO_RAY beyond its edges.
INLINED int place_of_ray(const int width, const int ray_count)
{
    const int column = get_global_id(0);
    const int place = (int)get_global_id(1) * width + column;
    return column < width && place < ray_count ? place : NO_RAY;
}

INLINED int tile_of_ray(void)
{
    return get_group_id(1) * get_num_groups(0) + get_group_id(0);
}

// The number of the ray in a place: rays that lie side by side should be close together, see clbvh/trace/ray_order.py.
// Without an order they are as they were given.
INLINED int number_of_ray(const global int *order, const int place)
{
    return order ? order[place] : place;
}
