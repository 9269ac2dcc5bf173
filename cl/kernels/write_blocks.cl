// Writes the primitives of the leaves as a layout stores them, see `layouts/leaf_blocks.py`: BLOCK_WIDTH in a block.
//
// KINDS: the bit of one kind, whose primitives consist of PRIM_NUMBERS numbers, see clbvh/kinds.py.
// HAS_FP64 as 1: degenerate triangles are found by the rule of `Mesh.degenerate_faces`; else the host tells them.
//
// points, corners                    see tree/prims.cl; of other kinds than triangles 0 without boxes
// numbers[][PRIM_NUMBERS]            of other kinds
// degenerate[]                       whether a triangle is, of devices without doubles
// prims[block_count * BLOCK_WIDTH]   primitives, NO_PRIM in the lanes that are left over
// blocks[]                           structs of the layout as 4-byte lanes, from first_block on
// boxes[block_count]                 see tree/boxes.cl; or 0

#ifndef BLOCK_WIDTH
#define BLOCK_WIDTH 1
#endif
#ifndef PRIM_NUMBERS
#define PRIM_NUMBERS 9
#endif
#ifndef HAS_FP64
#define HAS_FP64 0
#endif

#include "structs.cl"
#include "triangles/collinear.cl"
#include "tree/boxes.cl"

// Blocks of about 32 primitives. Half of that takes 13 % more time for `bvh2` (2-core x86-64 server).
#define BLOCKS_AHEAD (32 / BLOCK_WIDTH)

// In lanes without a primitive.
#define MISSING as_float(0x7fc00000)

#define SHAPE_ARGUMENTS \
    const global float *points, const global int *corners, const global float *numbers, const global uchar *degenerate

#define BLOCK_LANES ((PRIM_NUMBERS + 1) * BLOCK_WIDTH)

#if HAS_TRIANGLES

#if HAS_FP64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable

INLINED bool is_degenerate(const float at[9][BLOCK_WIDTH], const int slot)
{
    return is_collinear(
        (double3)(at[0][slot], at[1][slot], at[2][slot]), (double3)(at[3][slot], at[4][slot], at[5][slot]),
        (double3)(at[6][slot], at[7][slot], at[8][slot]));
}
#endif

// One number of each primitive of a block.
#if BLOCK_WIDTH == 8
typedef float8 row_t __attribute__((aligned(4)));
typedef int8 int_row_t __attribute__((aligned(4)));
#elif BLOCK_WIDTH == 4
typedef float4 row_t __attribute__((aligned(4)));
typedef int4 int_row_t __attribute__((aligned(4)));
#else
typedef float row_t;
typedef int int_row_t;
#endif

INLINED row_t least_of(const row_t a, const row_t b)
{
    return a < b ? a : b;
}

INLINED row_t size_of(const row_t a)
{
    return a < 0.0f ? -a : a;
}

// Whether two products surely differ, whatever float32 has rounded and flushed to zero.
INLINED int_row_t differ(const row_t p, const row_t q)
{
    return size_of(p - q) > 0x1p-20f * (size_of(p) + size_of(q)) + 0x1p-120f;
}

INLINED float least_in(const row_t row)
{
#if BLOCK_WIDTH == 8
    const float4 of_four = row.lo < row.hi ? row.lo : row.hi;
#elif BLOCK_WIDTH == 4
    const float4 of_four = row;
#endif
#if BLOCK_WIDTH > 1
    const float2 of_two = of_four.lo < of_four.hi ? of_four.lo : of_four.hi;
    return smaller(of_two.x, of_two.y);
#else
    return row;
#endif
}

INLINED box_t write_prims(SHAPE_ARGUMENTS, const global int *prims, global float *lanes)
{
    float at[9][BLOCK_WIDTH];
#pragma unroll
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        // A missing primitive repeats the first one, which is always there.
        const int prim = prims[slot] == NO_PRIM ? prims[0] : prims[slot];
#pragma unroll
        for (int corner = 0; corner < 3; corner++) {
            const global float *point = points + 3 * (long)corners[3 * (long)prim + corner];
            at[3 * corner][slot] = point[0];
            at[3 * corner + 1][slot] = point[1];
            at[3 * corner + 2][slot] = point[2];
        }
    }
    row_t rows[9];
#pragma unroll
    for (int lane = 0; lane < 9; lane++) {
        rows[lane] = *(const row_t *)at[lane];
        *(global row_t *)(lanes + lane * BLOCK_WIDTH) = rows[lane];
    }
    float lower[3];
    float upper[3];
#pragma unroll
    for (int axis = 0; axis < 3; axis++) {
        // Zero is added as in box_of_prim.
        lower[axis] = least_in(least_of(least_of(rows[axis], rows[3 + axis]), rows[6 + axis])) + 0.0f;
        upper[axis] = -least_in(least_of(least_of(-rows[axis], -rows[3 + axis]), -rows[6 + axis])) + 0.0f;
    }
    const row_t ux = rows[3] - rows[0];
    const row_t uy = rows[4] - rows[1];
    const row_t uz = rows[5] - rows[2];
    const row_t vx = rows[6] - rows[0];
    const row_t vy = rows[7] - rows[1];
    const row_t vz = rows[8] - rows[2];
    int is_sure[BLOCK_WIDTH];
    *(int_row_t *)is_sure = differ(uy * vz, uz * vy) | differ(uz * vx, ux * vz) | differ(ux * vy, uy * vx);
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        if (prims[slot] != NO_PRIM && is_sure[slot]) {
            continue;
        }
#if HAS_FP64
        if (prims[slot] != NO_PRIM && !is_degenerate(at, slot)) {
#else
        if (prims[slot] != NO_PRIM && !degenerate[prims[slot]]) {
#endif
            continue;
        }
        for (int lane = 0; lane < 9; lane++) {
            lanes[lane * BLOCK_WIDTH + slot] = MISSING;
        }
    }
    const box_t box = {(float3)(lower[0], lower[1], lower[2]), (float3)(upper[0], upper[1], upper[2])};
    return box;
}

#else

INLINED box_t write_prims(SHAPE_ARGUMENTS, const global int *prims, global float *lanes)
{
    box_t box = empty_box();
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        const bool is_there = prims[slot] != NO_PRIM;
        if (is_there && points != 0) {
            box = unite(box_of_prim(points, corners, prims[slot]), box);
        }
        for (int lane = 0; lane < PRIM_NUMBERS; lane++) {
            lanes[lane * BLOCK_WIDTH + slot] = is_there ? numbers[PRIM_NUMBERS * (long)prims[slot] + lane] : MISSING;
        }
    }
    return box;
}

#endif

// Ask for the memory of later blocks: their primitives lie anywhere.
INLINED void ask_ahead(SHAPE_ARGUMENTS, const global int *prims, const int block, const int block_count)
{
    const global int *far = prims + BLOCK_WIDTH * (long)min(block + 2 * BLOCKS_AHEAD, block_count - 1);
    const global int *near = prims + BLOCK_WIDTH * (long)min(block + BLOCKS_AHEAD, block_count - 1);
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
#if !HAS_TRIANGLES
        WILL_READ(numbers + PRIM_NUMBERS * (long)far[slot]);
#else
        WILL_READ(corners + 3 * (long)far[slot]);
        const long next = 3 * (long)max(near[slot], 0);
        for (int i = 0; i < 3; i++) {
            WILL_READ(points + 3 * (long)corners[next + i]);
        }
#endif
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
    ask_ahead(points, corners, numbers, degenerate, prims, block, block_count);
    const global int *own = prims + BLOCK_WIDTH * (long)block;
    const box_t box = write_prims(points, corners, numbers, degenerate, own, lanes);
    for (int slot = 0; slot < BLOCK_WIDTH; slot++) {
        ((global int *)lanes)[PRIM_NUMBERS * BLOCK_WIDTH + slot] = own[slot];
    }
    if (boxes != 0) {
        store_box(boxes, block, box, 0.0f);
    }
}
