// Vectors of WIDTH lanes, one per box or triangle: the vector unit of a CPU works inside one work-item.
//
// Assumes WIDTH 4 or 8. PORTABLE: see math/inlined.cl.

#include "math/numeric.cl"

#if WIDTH == 8
typedef float8 lanes_t;
typedef int8 lane_mask_t;
#else
typedef float4 lanes_t;
typedef int4 lane_mask_t;
#endif

// Assumes an address that is a multiple of the vector's size: device buffers begin at one, and structs of the wide
// layouts consist of whole vectors.
INLINED lanes_t load_lanes(const global float *from)
{
    return *(const global lanes_t *)from;
}

// Assumes no more than the alignment of a float.
typedef lanes_t packed_lanes_t __attribute__((aligned(4)));

INLINED lanes_t load_packed_lanes(const global float *from)
{
    return *(const global packed_lanes_t *)from;
}

// If one operand is NaN, the result is b, as in `smaller` and `larger`.
INLINED lanes_t smaller_lanes(const lanes_t a, const lanes_t b)
{
    return a < b ? a : b;
}

INLINED lanes_t larger_lanes(const lanes_t a, const lanes_t b)
{
    return a > b ? a : b;
}

INLINED float largest_of_lanes(const lanes_t a)
{
#if WIDTH == 8
    const float4 of_four = a.lo > a.hi ? a.lo : a.hi;
#else
    const float4 of_four = a;
#endif
    const float2 of_two = of_four.lo > of_four.hi ? of_four.lo : of_four.hi;
    return larger(of_two.x, of_two.y);
}

// a * b + c with a single rounding where an instruction exists, and with two elsewhere, where fma would be slow.
#if !defined(__clang__) || !(defined(__FMA__) || defined(__aarch64__)) || defined(PORTABLE)
#define MULTIPLY_ADD_LANES(a, b, c) ((a) * (b) + (c))
#elif __has_builtin(__builtin_elementwise_fma)
#define MULTIPLY_ADD_LANES(a, b, c) __builtin_elementwise_fma(a, b, c)
#elif WIDTH == 8 && defined(__FMA__)
#define MULTIPLY_ADD_LANES(a, b, c) __builtin_ia32_vfmaddps256(a, b, c)
#elif WIDTH == 4 && defined(__FMA__)
#define MULTIPLY_ADD_LANES(a, b, c) __builtin_ia32_vfmaddps(a, b, c)
#else
#define MULTIPLY_ADD_LANES(a, b, c) ((a) * (b) + (c))
#endif

// Returns one bit per lane, set where the comparison is true. Compilers do not find the x86 instruction for it.
#if WIDTH == 8 && defined(__clang__) && defined(__AVX__) && !defined(PORTABLE)
INLINED uint mask_bits(const lane_mask_t mask)
{
    return __builtin_ia32_movmskps256(as_float8(mask));
}
#elif WIDTH == 4 && defined(__clang__) && defined(__SSE__) && !defined(PORTABLE)
INLINED uint mask_bits(const lane_mask_t mask)
{
    return __builtin_ia32_movmskps(as_float4(mask));
}
#else
INLINED uint mask_bits(const lane_mask_t mask)
{
#if WIDTH == 8
    const int8 bits = mask & (int8)(1, 2, 4, 8, 16, 32, 64, 128);
    const int4 bits_of_four = bits.lo | bits.hi;
#else
    const int4 bits_of_four = mask & (int4)(1, 2, 4, 8);
#endif
    const int2 bits_of_two = bits_of_four.lo | bits_of_four.hi;
    return bits_of_two.x | bits_of_two.y;
}
#endif

// The index of the lowest set bit.
INLINED int lowest_bit(const uint bits)
{
#if defined(__clang__) && !defined(PORTABLE)
    return __builtin_ctz(bits);
#else
    return 31 - clz(bits & -bits);
#endif
}

// The primitives of a block, of which those that are missing come last.
INLINED int count_prims(const global int *prim_ids)
{
    int count = 0;
    for (int lane = 0; lane < WIDTH; lane++) {
        count += prim_ids[lane] != NO_PRIM;
    }
    return count;
}
