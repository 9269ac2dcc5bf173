// Rules of arithmetic that every file here relies on.

// A contracted a * b - c * d rounds differently for the two triangles of an edge, and a ray could slip between them.
// Drivers may contract unless told otherwise; PoCL 3.0 does.
#pragma OPENCL FP_CONTRACT OFF

// Half the distance from 1 to the next float, and the bound on n roundings in a row (Higham, "Accuracy and stability
// of numerical algorithms", 2002).
#define ROUNDING 5.9604645e-8f
#define ERROR_BOUND(n) ((n) * ROUNDING / (1.0f - (n) * ROUNDING))

// Written out, because fmin and fmax must look for NaN and are slower for it. If one operand is NaN, the result is b.
float smaller(const float a, const float b)
{
    return a < b ? a : b;
}

float larger(const float a, const float b)
{
    return a > b ? a : b;
}
