// Rules of arithmetic for all kernels: no contraction, the bound on rounding, and small functions of numbers.
// PORTABLE: see math/inlined.cl.

#include "math/inlined.cl"

// A contracted a * b - c * d rounds differently for the two triangles at an edge, and a ray could slip between them.
// Drivers may contract by default; PoCL 3.0 does.
#pragma OPENCL FP_CONTRACT OFF

// The unit roundoff of float32, and the bound on the relative error of n successive roundings (Higham, "Accuracy and
// stability of numerical algorithms", 2002).
#define ROUNDING 5.9604645e-8f
#define ERROR_BOUND(n) ((n) * ROUNDING / (1.0f - (n) * ROUNDING))

// fmin and fmax test for NaN, which makes them slower. Here, if one operand is NaN, the result is b.
INLINED float smaller(const float a, const float b)
{
    return a < b ? a : b;
}

INLINED float larger(const float a, const float b)
{
    return a > b ? a : b;
}

// Built-in functions needed per box or triangle are written in plain C where that is possible: PoCL 3.0 calls those of
// its library, and does not inline them if the library was built for another processor.

INLINED float3 load3(const global float *from)
{
    return (float3)(from[0], from[1], from[2]);
}

#if defined(__clang__) && defined(__SSE4_1__) && !defined(PORTABLE)
INLINED float square_root(const float x)
{
    return __builtin_sqrtf(x);
}

// The nearest integer, the even one of two.
INLINED float nearest_integer(const float x)
{
    return __builtin_rintf(x);
}

// The greatest integer that is not above x.
INLINED float round_down(const float x)
{
    return __builtin_floorf(x);
}
#else
INLINED float square_root(const float x)
{
    return sqrt(x);
}

INLINED float nearest_integer(const float x)
{
    return rint(x);
}

INLINED float round_down(const float x)
{
    return floor(x);
}
#endif

// A number limited to 0..1; NaN becomes 0.
INLINED float limit_share(const float x)
{
    return smaller(larger(x, 0.0f), 1.0f);
}

INLINED float absolute(const float x)
{
    return as_float(as_int(x) & 0x7fffffff);
}

// The absolute value of each component.
INLINED float3 magnitude(const float3 v)
{
    return as_float3(as_int3(v) & 0x7fffffff);
}

// Per component: a where the mask is true, else b. As integers, since compilers make a branch of a choice between
// vectors by one condition.
INLINED float3 choose3(const int3 mask, const float3 a, const float3 b)
{
    return as_float3((mask & as_int3(a)) | (~mask & as_int3(b)));
}

// a * b + c with a single rounding.
#if defined(__clang__) && defined(__FMA__) && !defined(PORTABLE)
#define FUSED(a, b, c) __builtin_fmaf(a, b, c)
#else
#define FUSED(a, b, c) fma(a, b, c)
#endif
