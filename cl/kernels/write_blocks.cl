// Writes the primitives of the leaves as a layout stores them, see `layouts/leaf_blocks.py`: BLOCK_WIDTH in a block.
//
// HAS_SPHERES as 1: centres and radii in place of points and corners.
// HAS_FP64 as 1: degenerate triangles are found by the rule of `Mesh.degenerate_faces`; else the host tells them.
//
// prims[block_count * BLOCK_WIDTH]   primitives, NO_PRIM in the lanes that are left over
// blocks[]                           structs of the layout as 4-byte lanes

#ifndef BLOCK_WIDTH
#define BLOCK_WIDTH 1
#endif
#ifndef HAS_FP64
#define HAS_FP64 0
#endif

// Lanes without a primitive, and degenerate triangles in a block of several.
#define MISSING as_float(0x7fc00000)

#include "structs.cl"
#include "math/numeric.cl"

#if HAS_SPHERES

kernel void write_blocks(
    const global float *centres, const global float *radii, const global int *prims, global float *blocks,
    const int block_count)
{
    const int block = (int)get_global_id(0);
    if (block >= block_count) {
        return;
    }
    global float *lanes = blocks + 5 * BLOCK_WIDTH * (long)block;
    global int *lane_ints = (global int *)lanes;
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        const int prim = prims[BLOCK_WIDTH * (long)block + slot];
        for (int axis = 0; axis < 3; axis++) {
            lanes[axis * BLOCK_WIDTH + slot] = prim == NO_PRIM ? MISSING : centres[3 * (long)prim + axis];
        }
        lanes[3 * BLOCK_WIDTH + slot] = prim == NO_PRIM ? MISSING : radii[prim];
        lane_ints[4 * BLOCK_WIDTH + slot] = prim;
    }
}

#else

#if HAS_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable

INLINED bool is_degenerate(const float3 a, const float3 b, const float3 c)
{
    const double3 u = convert_double3(b) - convert_double3(a);
    const double3 v = convert_double3(c) - convert_double3(a);
    return u.y * v.z == u.z * v.y && u.z * v.x == u.x * v.z && u.x * v.y == u.y * v.x;
}
#endif

kernel void write_blocks(
    const global float *points, const global int *corners, const global uchar *degenerate, const global int *prims,
    global float *blocks, const int block_count)
{
    const int block = (int)get_global_id(0);
    if (block >= block_count) {
        return;
    }
    global float *lanes = blocks + 10 * BLOCK_WIDTH * (long)block;
    global int *lane_ints = (global int *)lanes;
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        const int prim = prims[BLOCK_WIDTH * (long)block + slot];
        float3 own[3];
        for (int i = 0; i < 3; i++) {
            const int point = prim == NO_PRIM ? 0 : corners[3 * (long)prim + i];
            own[i] = prim == NO_PRIM ? (float3)(MISSING) : load3(points + 3 * (long)point);
        }
#if HAS_FP64
        const bool is_missing = prim != NO_PRIM && is_degenerate(own[0], own[1], own[2]);
#else
        const bool is_missing = prim != NO_PRIM && degenerate[prim];
#endif
        if (is_missing) {
            own[0] = BLOCK_WIDTH > 1 ? (float3)(MISSING) : own[0];
            own[1] = own[0];
            own[2] = own[0];
        }
        for (int i = 0; i < 3; i++) {
            lanes[(3 * i) * BLOCK_WIDTH + slot] = own[i].x;
            lanes[(3 * i + 1) * BLOCK_WIDTH + slot] = own[i].y;
            lanes[(3 * i + 2) * BLOCK_WIDTH + slot] = own[i].z;
        }
        lane_ints[9 * BLOCK_WIDTH + slot] = prim;
    }
}

#endif
