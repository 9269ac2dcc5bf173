// One pass of a stable radix sort of pairs by a digit of their keys: count, sum up, scatter (Satish, Harris and
// Garland, "Designing efficient sorting algorithms for manycore GPUs", 2009).
//
// DIGIT_BITS     bits of a digit
// GROUP_SIZE     items of a work-group. A CPU has one, whose counters stay in its cache, and no barrier
//
// pairs[n]       keys in the upper half
// counts[]       for each digit, the pairs in each chunk: those of a work-group
// shift          of the digit in a pair
// chunk_size     pairs of a work-group

#ifndef DIGIT_BITS
#define DIGIT_BITS 8
#endif
#ifndef GROUP_SIZE
#define GROUP_SIZE 1
#endif

#include "math/numeric.cl"

#define DIGITS (1 << DIGIT_BITS)

#if GROUP_SIZE > 1
#define WAIT barrier(CLK_LOCAL_MEM_FENCE)
#else
#define WAIT
#endif

#define SORT_ARGUMENTS \
    const global ulong *pairs, const int pair_count, const int chunk_size, const int chunk_count, const int shift, \
    global uint *counts

INLINED uint digit_of(const ulong pair, const int shift)
{
    return (uint)(pair >> shift) & (DIGITS - 1);
}

// The pairs of this item.
typedef struct {
    int begin;
    int end;
} span_t;

INLINED span_t find_span(const int group, const int pair_count, const int chunk_size)
{
    const int size = chunk_size / GROUP_SIZE;
    const long begin = (long)group * chunk_size + (long)get_local_id(0) * size;
    const span_t span = {(int)min(begin, (long)pair_count), (int)min(begin + size, (long)pair_count)};
    return span;
}

// Count the digits of each item, and replace the counts by sums over the items before. The sums over all items go to
// `totals`, unless that is 0.
INLINED void count_own_digits(
    const global ulong *pairs, const span_t span, const int shift, local uint own[DIGITS][GROUP_SIZE],
    global uint *totals, const int stride)
{
    const int item = (int)get_local_id(0);
    for (int digit = 0; digit < DIGITS; digit++) {
        own[digit][item] = 0;
    }
    for (int i = span.begin; i < span.end; i++) {
        own[digit_of(pairs[i], shift)][item]++;
    }
    WAIT;
    for (int digit = item; digit < DIGITS; digit += GROUP_SIZE) {
        uint sum = 0;
        for (int other = 0; other < GROUP_SIZE; other++) {
            const uint count = own[digit][other];
            own[digit][other] = sum;
            sum += count;
        }
        if (totals != 0) {
            totals[digit * stride] = sum;
        }
    }
    WAIT;
}

kernel void count_digits(SORT_ARGUMENTS)
{
    local uint own[DIGITS][GROUP_SIZE];
    const span_t span = find_span(get_group_id(0), pair_count, chunk_size);
    count_own_digits(pairs, span, shift, own, counts + get_group_id(0), chunk_count);
}

// Replace the counts by sums over all smaller digits, and over the chunks before; one work-group.
kernel void sum_counts(global uint *counts, const int count)
{
    local uint sums[GROUP_SIZE];
    const int item = (int)get_local_id(0);
    const int size = (count + GROUP_SIZE - 1) / GROUP_SIZE;
    const int begin = min(item * size, count);
    const int end = min(begin + size, count);
    uint sum = 0;
    for (int i = begin; i < end; i++) {
        sum += counts[i];
    }
    sums[item] = sum;
    WAIT;
    uint before = 0;
    for (int other = 0; other < item; other++) {
        before += sums[other];
    }
    for (int i = begin; i < end; i++) {
        const uint own = counts[i];
        counts[i] = before;
        before += own;
    }
}

kernel void scatter_pairs(SORT_ARGUMENTS, global ulong *sorted)
{
    local uint next[DIGITS][GROUP_SIZE];
    const span_t span = find_span(get_group_id(0), pair_count, chunk_size);
    const int item = (int)get_local_id(0);
#if GROUP_SIZE > 1
    count_own_digits(pairs, span, shift, next, 0, 0);
    for (int i = span.begin; i < span.end; i++) {
        const ulong pair = pairs[i];
        const uint digit = digit_of(pair, shift);
        sorted[counts[digit * chunk_count + get_group_id(0)] + next[digit][item]++] = pair;
    }
#else
    // One item needs no counts of its own.
    for (int digit = 0; digit < DIGITS; digit++) {
        next[digit][0] = counts[digit * chunk_count + get_group_id(0)];
    }
    for (int i = span.begin; i < span.end; i++) {
        const ulong pair = pairs[i];
        sorted[next[digit_of(pair, shift)][item]++] = pair;
    }
#endif
}
