// What OpenCL C gives a kernel, for kernels that are compiled as a library for the host: the built-in functions and
// types that the sources use, and the numbers of the work-item. Compiled with `-x cl`, before every other line.
//
// There is one address space, and a work-group is one thread that runs its work-items one after the other: kernels that
// need a barrier are compiled with GROUP_SIZE 1 for it.

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// See math/inlined.cl.
#define ON_HOST

typedef unsigned char uchar;
typedef unsigned int uint;
typedef unsigned long ulong;
typedef __SIZE_TYPE__ size_t;

#define VECTORS(type) \
    typedef type type##2 __attribute__((ext_vector_type(2))); \
    typedef type type##3 __attribute__((ext_vector_type(3))); \
    typedef type type##4 __attribute__((ext_vector_type(4))); \
    typedef type type##8 __attribute__((ext_vector_type(8)));
VECTORS(uchar)
VECTORS(int)
VECTORS(uint)
VECTORS(float)
VECTORS(double)

#define kernel static inline __attribute__((always_inline))
#define global
#define local
#define constant const

#define FLT_MAX 0x1.fffffep127f
#define FLT_MIN 0x1p-126f
#define FLT_EPSILON 0x1p-23f
#define INT_MAX 0x7fffffff
#define INT_MIN (-0x7fffffff - 1)
#define UINT_MAX 0xffffffffu
#define ULONG_MAX 0xfffffffffffffffful
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")

#define BUILTIN static inline __attribute__((overloadable, always_inline))

// The numbers of a work-item. Every kernel has them as its first argument, which the host's compiler adds to the text:
// they stay in registers.
typedef struct {
    int global_id[2];
    int group_id[2];
    int global_size[2];
    int group_count[2];
} work_item_t;

#define get_global_id(axis) (work_item.global_id[axis])
#define get_group_id(axis) (work_item.group_id[axis])
#define get_local_id(axis) 0
#define get_global_size(axis) (work_item.global_size[axis])
#define get_num_groups(axis) (work_item.group_count[axis])

#define CLK_LOCAL_MEM_FENCE 1
#define CLK_GLOBAL_MEM_FENCE 2
#define barrier(fences)

BUILTIN int atomic_max(int *address, const int value) { return __atomic_fetch_max(address, value, __ATOMIC_RELAXED); }
BUILTIN int atomic_min(int *address, const int value) { return __atomic_fetch_min(address, value, __ATOMIC_RELAXED); }

#define as_float(x) __builtin_astype((x), float)
#define as_float3(x) __builtin_astype((x), float3)
#define as_float4(x) __builtin_astype((x), float4)
#define as_float8(x) __builtin_astype((x), float8)
#define as_int(x) __builtin_astype((x), int)
#define as_int3(x) __builtin_astype((x), int3)
#define as_int8(x) __builtin_astype((x), int8)
#define as_uint(x) __builtin_astype((x), uint)
#define as_long(x) __builtin_astype((x), long)
#define as_double(x) __builtin_astype((x), double)

#define convert_float3(x) __builtin_convertvector((x), float3)
#define convert_float4(x) __builtin_convertvector((x), float4)
#define convert_double3(x) __builtin_convertvector((x), double3)
#define convert_int3(x) __builtin_convertvector((x), int3)

// Of two that do not compare, the first stays.
#define LEAST_AND_MOST(type) \
    BUILTIN type min(const type a, const type b) { return b < a ? b : a; } \
    BUILTIN type max(const type a, const type b) { return a < b ? b : a; }
LEAST_AND_MOST(int)
LEAST_AND_MOST(long)
LEAST_AND_MOST(int8)
LEAST_AND_MOST(float)
LEAST_AND_MOST(float3)

BUILTIN float3 min(const float3 a, const float b) { return min(a, (float3)(b)); }
BUILTIN float3 max(const float3 a, const float b) { return max(a, (float3)(b)); }

BUILTIN int clamp(const int x, const int least, const int most) { return min(max(x, least), most); }
BUILTIN float clamp(const float x, const float least, const float most) { return min(max(x, least), most); }
BUILTIN float3 clamp(const float3 x, const float least, const float most) { return min(max(x, least), most); }

BUILTIN float fmax(const float a, const float b) { return __builtin_fmaxf(a, b); }
BUILTIN float3 fmax(const float3 a, const float3 b)
{
    return (float3)(__builtin_fmaxf(a.x, b.x), __builtin_fmaxf(a.y, b.y), __builtin_fmaxf(a.z, b.z));
}
BUILTIN float3 fmax(const float3 a, const float b) { return fmax(a, (float3)(b)); }

#define BY_COMPONENT(name, of_float, of_double) \
    BUILTIN float name(const float x) { return of_float(x); } \
    BUILTIN float2 name(const float2 v) { return (float2)(of_float(v.x), of_float(v.y)); } \
    BUILTIN float3 name(const float3 v) { return (float3)(of_float(v.x), of_float(v.y), of_float(v.z)); } \
    BUILTIN float4 name(const float4 v) { return (float4)(name(v.lo), name(v.hi)); } \
    BUILTIN float8 name(const float8 v) { return (float8)(name(v.lo), name(v.hi)); } \
    BUILTIN double name(const double x) { return of_double(x); } \
    BUILTIN double3 name(const double3 v) { return (double3)(of_double(v.x), of_double(v.y), of_double(v.z)); }
BY_COMPONENT(fabs, __builtin_fabsf, __builtin_fabs)
BY_COMPONENT(floor, __builtin_floorf, __builtin_floor)
BY_COMPONENT(rint, __builtin_rintf, __builtin_rint)
BY_COMPONENT(sqrt, __builtin_sqrtf, __builtin_sqrt)

BUILTIN float fma(const float a, const float b, const float c) { return __builtin_fmaf(a, b, c); }
BUILTIN double fma(const double a, const double b, const double c) { return __builtin_fma(a, b, c); }

BUILTIN int isnan(const float x) { return x != x; }
BUILTIN int isnan(const double x) { return x != x; }
BUILTIN int isfinite(const double x) { return __builtin_fabs(x) < __builtin_inf(); }

BUILTIN int abs(const int x) { return x < 0 ? -x : x; }
BUILTIN int clz(const uint x) { return x ? __builtin_clz(x) : 32; }
BUILTIN int popcount(const uint x) { return __builtin_popcount(x); }
BUILTIN int all(const int3 mask) { return (mask.x & mask.y & mask.z) < 0; }

BUILTIN uchar convert_uchar_sat_rte(const float x) { return (uchar)__builtin_rintf(clamp(x, 0.0f, 255.0f)); }
BUILTIN uchar3 convert_uchar3_sat_rte(const float3 v)
{
    return (uchar3)(convert_uchar_sat_rte(v.x), convert_uchar_sat_rte(v.y), convert_uchar_sat_rte(v.z));
}

BUILTIN void vstore3(const double3 v, const size_t index, double *target)
{
    target[3 * index] = v.x;
    target[3 * index + 1] = v.y;
    target[3 * index + 2] = v.z;
}
BUILTIN void vstore3(const float3 v, const size_t index, float *target)
{
    target[3 * index] = v.x;
    target[3 * index + 1] = v.y;
    target[3 * index + 2] = v.z;
}
