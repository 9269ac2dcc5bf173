// The choice of one of many things, each with its own probability, in one step: the alias method (Walker, "An efficient
// method for generating discrete random variables with general distributions", 1977).
//
// choices[count]  light_choice_t: an index is drawn evenly, and stays if the fraction that is left is below its
//                 threshold; otherwise its alias is taken. See clbvh/rendering/film/light_tables.py

#include "structs.cl"
#include "sampling/hash.cl"

// A fixed-point number from 0 to just below 1 times a count: the integer part, and in *rest the fraction.
INLINED uint split_product(const uint sample, const uint count, uint *rest)
{
    // Not by mul_hi, which PoCL 3.0 calls.
    const ulong product = (ulong)sample * count;
    *rest = (uint)product;
    return (uint)(product >> 32);
}

// `sample` is a fixed-point number from 0 to just below 1, evenly distributed. Among a million things, its fraction has
// 12 bits left; `more` has those that follow them.
INLINED int choose(const global light_choice_t *choices, const uint count, const uint sample, const uint more)
{
    uint fraction, unused;
    uint index = split_product(sample, count, &fraction);
    const uint following = split_product(more, count, &unused);
    fraction += following;
    // A carry; the sum is less than `count` as a whole.
    index += fraction < following ? 1u : 0u;
    return fraction < choices[index].threshold ? (int)index : choices[index].alias;
}
