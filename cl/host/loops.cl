// What loops of the host have besides what kernels have there. Compiled before them, after `host/builtins.cl`.

// A function that Python calls, see clbvh/device/host/loops.py.
#define loop static

// The arrays of loops need no alignment: they may be parts of a pickle, or of a file in memory. The option
// `-fmax-type-align=1` says the same of numbers.
#define ALIGNED(bytes)

// They meet primitives of all kinds.
#define KINDS -1

BUILTIN double3 vload3(const size_t index, const double *from)
{
    return (double3)(from[3 * index], from[3 * index + 1], from[3 * index + 2]);
}

LEAST_AND_MOST(uint)
LEAST_AND_MOST(ulong)
LEAST_AND_MOST(double)
LEAST_AND_MOST(double3)

#define convert_int4(x) __builtin_convertvector((x), int4)
#define convert_double4(x) __builtin_convertvector((x), double4)
