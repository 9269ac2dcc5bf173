// The pattern of the samples of a pixel: the sequence R2, of which any number of points in a row is evenly spread
// (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).

#include "sampling/sampler.cl"

// Fixed-point numbers; the steps are 1 / g and 1 / g^2 with g^3 = g + 1.
#define R2_START 0x80000000u
#define R2_STEP_X 0xc13fa9a9u
#define R2_STEP_Y 0x91e10da6u

// A point of the unit square; of sample 0, its middle.
INLINED float2 pattern_point(const uint sample)
{
    return (float2)(as_unit_float(R2_START + sample * R2_STEP_X), as_unit_float(R2_START + sample * R2_STEP_Y));
}

// Where a sample of a cell is from the centre of its pixel, -0.5 to 0.5 in each direction; see film/cells.cl.
INLINED float2 find_offset(const uint sample)
{
    return pattern_point(sample) - 0.5f;
}
