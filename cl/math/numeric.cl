// Rules of arithmetic that every file here relies on.

#include "inlined.cl"

// A contracted a * b - c * d rounds differently for the two triangles of an edge, and a ray could slip between them.
// Drivers may contract unless told otherwise; PoCL 3.0 does.
#pragma OPENCL FP_CONTRACT OFF

// Half the distance from 1 to the next float, and the bound on n roundings in a row (Higham, "Accuracy and stability
// of numerical algorithms", 2002).
#define ROUNDING 5.9604645e-8f
#define ERROR_BOUND(n) ((n) * ROUNDING / (1.0f - (n) * ROUNDING))

// Written out, because fmin and fmax must look for NaN and are slower for it. If one operand is NaN, the result is b.
INLINED float smaller(const float a, const float b)
{
    return a < b ? a : b;
}

INLINED float larger(const float a, const float b)
{
    return a > b ? a : b;
}

// Built-in functions that are used for every box or triangle are written out as well, as far as compilers know them:
// PoCL 3.0 calls its own ones and does not inline them when its library was made for another processor.

INLINED float3 load3(const global float *from)
{
    return (float3)(from[0], from[1], from[2]);
}

INLINED float3 magnitude(const float3 v)
{
    return as_float3(as_int3(v) & 0x7fffffff);
}

// a * b + c, rounded once.
#if defined(__clang__) && defined(__FMA__)
#define FUSED(a, b, c) __builtin_fmaf(a, b, c)
#else
#define FUSED(a, b, c) fma(a, b, c)
#endif
