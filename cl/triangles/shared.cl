// The leaves of the layout `bvh8c`: blocks that have each vertex of up to 8 triangles once, see
// `layouts/shared_blocks.py`. A leaf is the index of the first unit of its first block.

#include "math/lanes.cl"

typedef const global uint *leaf_t;

INLINED leaf_t leaf_at(const global block_t *blocks, const int block)
{
    return blocks[block].words;
}

INLINED int vertices_in(const leaf_t leaf)
{
    return leaf[SHARED_HEADER - 1] & 0xff;
}

INLINED int triangles_in(const leaf_t leaf)
{
    return leaf[SHARED_HEADER - 1] >> 8 & 0xff;
}

// Lanes to test.
INLINED int lane_count(const leaf_t leaf)
{
    return triangles_in(leaf);
}

INLINED int next_block(const leaf_t leaf, const int block)
{
    const int unit_count = leaf[SHARED_HEADER - 1] >> 16;
    return unit_count > 0 ? block + unit_count : NO_BLOCK;
}

INLINED int prim_id_of(const leaf_t leaf, const uint lane)
{
    return leaf[SHARED_HEADER + 3 * vertices_in(leaf) + lane];
}

// One coordinate of all vertices.
INLINED const global float *vertex_row(const leaf_t leaf, const int axis)
{
    return (const global float *)(leaf + SHARED_HEADER + axis * vertices_in(leaf));
}

#define VERTEX_MASK ((1u << SHARED_VERTEX_BITS) - 1)

INLINED float3 corner_of(const leaf_t leaf, const int corner, const uint lane)
{
    const uint vertex = leaf[corner] >> SHARED_VERTEX_BITS * lane & VERTEX_MASK;
    return (float3)(vertex_row(leaf, 0)[vertex], vertex_row(leaf, 1)[vertex], vertex_row(leaf, 2)[vertex]);
}

// One coordinate of one corner of all triangles; anything in lanes without a triangle. 16 coordinates are loaded,
// whatever is behind the row: the host has put zeros behind the last block.
INLINED lanes_t load_row(const leaf_t leaf, const int corner, const int axis)
{
    const global float *row = vertex_row(leaf, axis);
    const uint8 vertices = (uint8)(leaf[corner]) >> (uint8)(0, 4, 8, 12, 16, 20, 24, 28);
#if defined(__clang__) && defined(__AVX2__) && !defined(PORTABLE)
    const float8 low = __builtin_ia32_permvarsf256(load_packed_lanes(row), as_int8(vertices));
    const float8 high = __builtin_ia32_permvarsf256(load_packed_lanes(row + 8), as_int8(vertices));
    return (vertices & 8) == 0 ? low : high;
#else
    const uint8 of_lane = vertices & VERTEX_MASK;
    return (float8)(
        row[of_lane.s0], row[of_lane.s1], row[of_lane.s2], row[of_lane.s3], row[of_lane.s4], row[of_lane.s5],
        row[of_lane.s6], row[of_lane.s7]);
#endif
}
