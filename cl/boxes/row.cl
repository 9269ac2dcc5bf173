// Boxes as eight lanes in one register, for the host's builders: a row of their arrays, `BOX` of clbvh/structs.py.
//
// A row is (min_x, min_y, min_z, tag, -max_x, -max_y, -max_z, tally). The maximum is negated, so that one minimum of
// eight lanes unites two boxes. A minimum leaves garbage in the tag and in the tally; only `add_to_row` keeps the
// tally, an integer.

// keep: no contraction
#include "structs.cl"
#include "math/numeric.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// In arrays of floats.
typedef float box_row_t __attribute__((ext_vector_type(8), aligned(1)));

// The neutral element of `unite`; its tally is 0.
#define EMPTY_ROW (float8)(INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, INFINITY, 0.0f)

INLINED float8 unite(const float8 left, const float8 right)
{
    return left < right ? left : right;
}

// The box of a point, without a negative zero.
INLINED float8 row_of_point(const float *point)
{
    const float4 half_row = (float4)(point[0], point[1], point[2], 0.0f);
    return (float8)(half_row, -half_row) + 0.0f;  // -0.0 + 0.0 is 0.0
}

INLINED int tag_of(const float8 row)
{
    return as_int(row.s3);
}

INLINED int tally_of(const float8 row)
{
    return as_int(row.s7);
}

INLINED float8 with_tag(float8 row, const int tag)
{
    row.s3 = as_float(tag);
    return row;
}

INLINED float8 with_tally(float8 row, const int tally)
{
    row.s7 = as_float(tally);
    return row;
}

// Unites a box into a row of an array, and counts it in the row's tally.
INLINED void add_to_row(box_row_t *row, const float8 box)
{
    const float8 before = *row;
    const float8 counted = as_float8(as_int8(before) + 1);
    const float8 united = unite(box, before);
    *row = (float8)(united.s0123, united.s45, united.s6, counted.s7);
}

// Writes a row as a node of a finished tree. Subtracted from 0 instead of negated, which could make -0.0.
INLINED void store_node(row_node_t *node, const float8 row, const int first, const int count)
{
    const float8 positive = 0.0f - row;
    const float8 lanes = (float8)(row.s012, as_float(first), positive.s456, as_float(count));
    *(box_row_t *)node = lanes;
}

// The box of a node, the inverse of `store_node`; the tag and the tally are of no meaning.
INLINED float8 row_of_node(const row_node_t *node)
{
    const float8 lanes = *(const box_row_t *)node;
    return (float8)(lanes.s0123, -lanes.s4567);
}

// The box that holds only the doubled centroid, min + max.
INLINED float8 doubled_centroid(const float8 row)
{
    return row - row.s45670123;
}

// The same along one axis.
INLINED float doubled_centroid_on(const box_row_t *row, const int axis)
{
    const float *lanes = (const float *)row;
    return lanes[axis] - lanes[axis + 4];
}

// Half the surface area of a box that is not empty: areas of a mesh that is 1e20 units wide do not fit float32.
INLINED double box_half_area(const float8 row)
{
    // Negative, which cancels in the products.
    const double4 size = convert_double4(row.s0122) + convert_double4(row.s4566);
    const double4 areas = size * size.s1200;
    return areas.s0 + areas.s1 + areas.s2;
}

// The factors `bin_count / extent` of a box in the first three lanes; 0 on an axis whose extent is not above
// `smallest_extent`.
INLINED float8 bin_scales(const float8 bounds, const float bin_count, const float smallest_extent)
{
    const float8 extent = -(bounds + bounds.s45670123);
    const float8 scale = bin_count / extent;
    return extent > smallest_extent ? scale : (float8)(0.0f);
}

// The bins of a box's centroid on the three axes, each `(int)((centroid - lower) * scale)`; the fourth lane repeats the
// third, since a tag is most often a number below the normal ones, and these take long to multiply.
INLINED int4 bins_of(const float8 row, const float8 lower, const float8 scale)
{
    const float4 centroid = row.s0122 - row.s4566;
    return convert_int4((centroid - lower.s0122) * scale.s0122);
}
