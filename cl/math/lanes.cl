// WIDTH boxes or triangles at a time, in the lanes of one vector: a CPU's vector unit works inside one work-item.
//
// PORTABLE, when defined, leaves the compilers' own functions aside.

#include "numeric.cl"

#if WIDTH == 8
typedef float8 lanes_t;
typedef int8 lane_mask_t;
#else
typedef float4 lanes_t;
typedef int4 lane_mask_t;
#endif

// The device's arrays begin at multiples of a vector's size, and rows of lanes follow each other.
INLINED lanes_t load_lanes(const global float *from)
{
    return *(const global lanes_t *)from;
}

// If one operand is NaN, the result is b, as for single numbers.
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

// a * b + c, rounded once where there is an instruction for it, twice elsewhere: fma would be slow there.
#if WIDTH == 8 && defined(__clang__) && defined(__FMA__) && !defined(PORTABLE)
#define MULTIPLY_ADD_LANES(a, b, c) __builtin_ia32_vfmaddps256(a, b, c)
#elif WIDTH == 4 && defined(__clang__) && defined(__FMA__) && !defined(PORTABLE)
#define MULTIPLY_ADD_LANES(a, b, c) __builtin_ia32_vfmaddps(a, b, c)
#else
#define MULTIPLY_ADD_LANES(a, b, c) ((a) * (b) + (c))
#endif

// A bit for each lane of a comparison that is true. x86 has an instruction for it, which compilers do not find.
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

// The number of the lowest bit that is set.
INLINED int lowest_bit(const uint bits)
{
#if defined(__clang__) && !defined(PORTABLE)
    return __builtin_ctz(bits);
#else
    return 31 - clz(bits & -bits);
#endif
}
