// The leaves of the layouts `bvh4` and `bvh8`: blocks with the corners of WIDTH triangles, side by side. A leaf is the
// index of its only block.

#include "math/lanes.cl"

typedef const global block_t *leaf_t;

INLINED leaf_t leaf_at(const global block_t *blocks, const int block)
{
    return blocks + block;
}

INLINED int triangles_in(const leaf_t leaf)
{
    return count_prims(leaf->prim_id);
}

// Lanes to test: all, since those without a triangle are NaN.
INLINED int lane_count(const leaf_t leaf)
{
    return WIDTH;
}

INLINED int next_block(const leaf_t leaf, const int block)
{
    return NO_BLOCK;
}

INLINED int prim_id_of(const leaf_t leaf, const uint lane)
{
    return leaf->prim_id[lane];
}

// One coordinate of one corner of all triangles.
INLINED lanes_t load_row(const leaf_t leaf, const int corner, const int axis)
{
    return load_lanes(leaf->corners[corner][axis]);
}

INLINED float3 corner_of(const leaf_t leaf, const int corner, const uint lane)
{
    return (float3)(leaf->corners[corner][0][lane], leaf->corners[corner][1][lane], leaf->corners[corner][2][lane]);
}
