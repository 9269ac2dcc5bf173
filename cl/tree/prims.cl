// The primitives that a tree is built over: their boxes, by their corners, and their order along the curve.

#include "math/numeric.cl"

typedef struct {
    float3 lower;
    float3 upper;
} box_t;

INLINED float3 smaller3(const float3 a, const float3 b)
{
    return (float3)(smaller(a.x, b.x), smaller(a.y, b.y), smaller(a.z, b.z));
}

INLINED float3 larger3(const float3 a, const float3 b)
{
    return (float3)(larger(a.x, b.x), larger(a.y, b.y), larger(a.z, b.z));
}

INLINED box_t unite(const box_t a, const box_t b)
{
    const box_t united = {smaller3(a.lower, b.lower), larger3(a.upper, b.upper)};
    return united;
}

// The primitives in memory.
//
// points[]     float3, packed: local coordinates
// corners[n]   int3, packed: the points of each primitive
// pairs[n]     keys and, in the lower half, primitives, in the order of the keys
typedef struct {
    const global float *points;
    const global int *corners;
    const global ulong *pairs;
} prims_t;

INLINED int prim_at(const prims_t *prims, const int place)
{
    return (int)(uint)prims->pairs[place];
}

// The box around a primitive; zero is added, since -0.0 would have other bytes.
INLINED box_t box_of_prim(const global float *points, const global int *corners, const int prim)
{
    const float3 a = load3(points + 3 * (long)corners[3 * (long)prim]);
    const float3 b = load3(points + 3 * (long)corners[3 * (long)prim + 1]);
    const float3 c = load3(points + 3 * (long)corners[3 * (long)prim + 2]);
    const box_t box = {smaller3(smaller3(a, b), c) + 0.0f, larger3(larger3(a, b), c) + 0.0f};
    return box;
}

// The sum of the areas of three sides.
INLINED float half_area(const box_t box)
{
    const float3 size = box.upper - box.lower;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}
