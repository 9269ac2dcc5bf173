// Boxes while a tree is built or refitted.

#include "math/numeric.cl"

typedef struct {
    float3 lower;
    float3 upper;
} box_t;

// A missing child has an inverted box, which no ray hits.
#define GREATEST 0x1.fffffep+127f

INLINED box_t empty_box(void)
{
    const box_t box = {(float3)(GREATEST), (float3)(-GREATEST)};
    return box;
}

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

// Half of the surface: the sum of the areas of three sides.
INLINED float box_area(const box_t box)
{
    const float3 size = box.upper - box.lower;
    return size.x * size.y + size.y * size.z + size.z * size.x;
}

// The box around a primitive, by its corners: points[] are float3, packed, and corners[] int3, packed, three points of
// each primitive. Zero is added, since -0.0 would have other bytes.
INLINED box_t box_of_prim(const global float *points, const global int *corners, const int prim)
{
    const float3 a = load3(points + 3 * (long)corners[3 * (long)prim]);
    const float3 b = load3(points + 3 * (long)corners[3 * (long)prim + 1]);
    const float3 c = load3(points + 3 * (long)corners[3 * (long)prim + 2]);
    const box_t box = {smaller3(smaller3(a, b), c) + 0.0f, larger3(larger3(a, b), c) + 0.0f};
    return box;
}

// A row of eight numbers holds a box, and one more number.
INLINED box_t load_box(const global float *rows, const int row)
{
    const box_t box = {load3(rows + 8 * (long)row), load3(rows + 8 * (long)row + 4)};
    return box;
}

INLINED void store_box(global float *rows, const int row, const box_t box, const float number)
{
    global float *lanes = rows + 8 * (long)row;
    lanes[0] = box.lower.x;
    lanes[1] = box.lower.y;
    lanes[2] = box.lower.z;
    lanes[3] = number;
    lanes[4] = box.upper.x;
    lanes[5] = box.upper.y;
    lanes[6] = box.upper.z;
}
