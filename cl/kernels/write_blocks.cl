// Writes the primitives of the leaves as a layout stores them, see `layouts/leaf_blocks.py`: BLOCK_WIDTH in a block.
//
// HAS_SPHERES as 1: blocks of centres and radii.
// HAS_FP64 as 1: degenerate triangles are found by the rule of `Mesh.degenerate_faces`; else the host tells them.
//
// points, corners                    see tree/prims.cl
// prims[block_count * BLOCK_WIDTH]   primitives, NO_PRIM in the lanes that are left over
// blocks[]                           structs of the layout as 4-byte lanes, from first_block on
// boxes[block_count]                 see tree/boxes.cl; or 0

#ifndef BLOCK_WIDTH
#define BLOCK_WIDTH 1
#endif
#ifndef HAS_FP64
#define HAS_FP64 0
#endif

#include "structs.cl"
#include "tree/boxes.cl"

// Blocks of about 16 primitives.
#define BLOCKS_AHEAD (16 / BLOCK_WIDTH)

// In lanes without a primitive.
#define MISSING as_float(0x7fc00000)

// centres, radii of spheres; and whether a triangle is degenerate, of devices without doubles.
#define SHAPE_ARGUMENTS \
    const global float *points, const global int *corners, const global float *centres, const global float *radii, \
    const global uchar *degenerate

#if HAS_SPHERES

#define BLOCK_LANES (5 * BLOCK_WIDTH)

INLINED void write_lane(SHAPE_ARGUMENTS, const int prim, global float *lanes)
{
    const float3 centre = load3(centres + 3 * (long)prim);
    lanes[0] = centre.x;
    lanes[BLOCK_WIDTH] = centre.y;
    lanes[2 * BLOCK_WIDTH] = centre.z;
    lanes[3 * BLOCK_WIDTH] = radii[prim];
}

#else

#define BLOCK_LANES (10 * BLOCK_WIDTH)

#if HAS_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable

INLINED bool is_degenerate(const float3 a, const float3 b, const float3 c)
{
    // Without vectors: PoCL calls the functions that convert these.
    const double ux = (double)b.x - (double)a.x;
    const double uy = (double)b.y - (double)a.y;
    const double uz = (double)b.z - (double)a.z;
    const double vx = (double)c.x - (double)a.x;
    const double vy = (double)c.y - (double)a.y;
    const double vz = (double)c.z - (double)a.z;
    return uy * vz == uz * vy && uz * vx == ux * vz && ux * vy == uy * vx;
}
#endif

INLINED void write_lane(SHAPE_ARGUMENTS, const int prim, global float *lanes)
{
    float3 own[3];
    for (int i = 0; i < 3; i++) {
        own[i] = load3(points + 3 * (long)corners[3 * (long)prim + i]);
    }
#if HAS_FP64
    const bool is_hidden = is_degenerate(own[0], own[1], own[2]);
#else
    const bool is_hidden = degenerate[prim];
#endif
    if (is_hidden) {
        own[0] = BLOCK_WIDTH > 1 ? (float3)(MISSING) : own[0];
        own[1] = own[0];
        own[2] = own[0];
    }
    for (int i = 0; i < 3; i++) {
        lanes[(3 * i) * BLOCK_WIDTH] = own[i].x;
        lanes[(3 * i + 1) * BLOCK_WIDTH] = own[i].y;
        lanes[(3 * i + 2) * BLOCK_WIDTH] = own[i].z;
    }
}

#endif

// Ask for the memory of later blocks: their primitives lie anywhere.
INLINED void ask_ahead(
    const global float *points, const global int *corners, const global int *prims, const int block,
    const int block_count)
{
    const global int *far = prims + BLOCK_WIDTH * (long)min(block + 2 * BLOCKS_AHEAD, block_count - 1);
    const global int *near = prims + BLOCK_WIDTH * (long)min(block + BLOCKS_AHEAD, block_count - 1);
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        WILL_READ(corners + 3 * (long)far[slot]);
        const long next = 3 * (long)max(near[slot], 0);
        for (int i = 0; i < 3; i++) {
            WILL_READ(points + 3 * (long)corners[next + i]);
        }
    }
}

kernel void write_blocks(
    SHAPE_ARGUMENTS, const global int *prims, global float *blocks, global float *boxes, const int block_count,
    const int first_block)
{
    const int block = (int)get_global_id(0);
    if (block >= block_count) {
        return;
    }
    global float *lanes = blocks + BLOCK_LANES * (first_block + (long)block);
    box_t box = empty_box();
    ask_ahead(points, corners, prims, block, block_count);
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        const int prim = prims[BLOCK_WIDTH * (long)block + slot];
        ((global int *)lanes)[BLOCK_LANES - BLOCK_WIDTH + slot] = prim;
        if (prim == NO_PRIM) {
            for (int lane = 0; lane < BLOCK_LANES - BLOCK_WIDTH; lane += BLOCK_WIDTH) {
                lanes[lane + slot] = MISSING;
            }
            continue;
        }
        write_lane(points, corners, centres, radii, degenerate, prim, lanes + slot);
        if (boxes != 0) {
            box = unite(box_of_prim(points, corners, prim), box);
        }
    }
    if (boxes != 0) {
        store_box(boxes, block, box, 0.0f);
    }
}
