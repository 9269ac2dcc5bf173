// How builders keep to the limits of trees.

#include "structs.cl"
#include "math/inlined.cl"

// Whether only splits by halves still keep the primitives of a node, at this depth, above MAX_DEPTH: they need
// log2(prim_count) levels, rounded up.
INLINED bool needs_halving(const int prim_count, const int depth)
{
    const int levels = 32 - clz((uint)prim_count - 1);
    return levels >= MAX_DEPTH - depth;
}

// Where the right half of a range begins.
INLINED long middle_of(const long begin, const long end)
{
    return begin + (end - begin) / 2;
}

// Inserts a primitive into the ascending list `prim_ids[begin]` to `prim_ids[end - 1]`, which then ends one later. One
// step of an insertion sort: O(1) when primitives arrive in ascending order, and no memory besides the list.
INLINED void insert_prim(int *prim_ids, const long begin, const long end, const int prim)
{
    long slot = end;
    while (slot > begin && prim_ids[slot - 1] > prim) {
        prim_ids[slot] = prim_ids[slot - 1];
        slot--;
    }
    prim_ids[slot] = prim;
}
