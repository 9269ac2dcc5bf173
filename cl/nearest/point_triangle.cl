// The distance of a triangle from zero: of a single one, or, if WIDTH is defined, of WIDTH triangles in lanes. Both are
// the same arithmetic with the same bits.

#include "math/numeric.cl"

#ifdef WIDTH
#include "math/lanes.cl"
typedef lanes_t real_t;
typedef lane_mask_t mask_t;
#define SMALLER smaller_lanes
#define LARGER larger_lanes
#else
typedef float real_t;
typedef int mask_t;
#define SMALLER smaller
#define LARGER larger
#endif

typedef struct {
    real_t x;
    real_t y;
    real_t z;
} point_t;

#ifdef WIDTH

typedef union {
    lanes_t lanes;
    float of_lane[WIDTH];
} distances_t;

// Three rows of a node or of a block.
INLINED point_t load_points(const global float rows[3][WIDTH])
{
    const point_t points = {load_lanes(rows[0]), load_lanes(rows[1]), load_lanes(rows[2])};
    return points;
}

#endif

INLINED point_t difference_of(const point_t a, const point_t b)
{
    const point_t result = {a.x - b.x, a.y - b.y, a.z - b.z};
    return result;
}

INLINED real_t dot_of(const point_t a, const point_t b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

INLINED point_t cross_of(const point_t a, const point_t b)
{
    const point_t result = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
    return result;
}

INLINED point_t select_point(const mask_t is_first, const point_t a, const point_t b)
{
    const point_t result = {is_first ? a.x : b.x, is_first ? a.y : b.y, is_first ? a.z : b.z};
    return result;
}

// An order of corners that does not depend on their triangle.
INLINED mask_t comes_before(const point_t a, const point_t b)
{
    return (a.x < b.x) | ((a.x == b.x) & ((a.y < b.y) | ((a.y == b.y) & (a.z < b.z))));
}

// The squared distance from an edge; the same bits for both orders of its ends.
INLINED real_t distance_squared_to_edge(const point_t one, const point_t other)
{
    const mask_t swap = comes_before(other, one);
    const point_t begin = select_point(swap, other, one);
    const point_t along = difference_of(select_point(swap, one, other), begin);
    // For an edge without length this is NaN, and the fraction 0.
    const real_t unlimited = -dot_of(begin, along) / dot_of(along, along);
    const real_t fraction = SMALLER(LARGER(unlimited, (real_t)(0.0f)), (real_t)(1.0f));
    const point_t nearest = {begin.x + fraction * along.x, begin.y + fraction * along.y, begin.z + fraction * along.z};
    return dot_of(nearest, nearest);
}

// The nearest point lies on an edge or in the interior. In the interior it is a weighted sum of the corners, the foot
// of the perpendicular. Rounded weights still give a point of the triangle, as long as none is negative, so the
// distance is never too small.
INLINED real_t distance_squared_to_triangle(const point_t a, const point_t b, const point_t c)
{
    const real_t to_edges = SMALLER(
        distance_squared_to_edge(a, b), SMALLER(distance_squared_to_edge(b, c), distance_squared_to_edge(c, a)));
    const point_t normal = cross_of(difference_of(b, a), difference_of(c, a));
    const real_t weight_a = dot_of(normal, cross_of(b, c));
    const real_t weight_b = dot_of(normal, cross_of(c, a));
    const real_t weight_c = dot_of(normal, cross_of(a, b));
    const real_t sum = weight_a + weight_b + weight_c;
    const mask_t is_inside = (weight_a >= 0.0f) & (weight_b >= 0.0f) & (weight_c >= 0.0f) & (sum > 0.0f);
    const real_t fraction_a = weight_a / sum;
    const real_t fraction_b = weight_b / sum;
    const real_t fraction_c = weight_c / sum;
    const point_t nearest = {
        fraction_a * a.x + fraction_b * b.x + fraction_c * c.x, fraction_a * a.y + fraction_b * b.y + fraction_c * c.y,
        fraction_a * a.z + fraction_b * b.z + fraction_c * c.z};
    const real_t to_interior = is_inside ? dot_of(nearest, nearest) : to_edges;
    return SMALLER(to_interior, to_edges);
}
