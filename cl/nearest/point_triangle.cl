// How far the zero point is from a triangle, or from WIDTH of them in lanes: the same arithmetic, the same bits.

#include "numeric.cl"

#ifdef WIDTH
#include "lanes.cl"
typedef lanes_t real_t;
typedef lane_mask_t truth_t;
#define SMALLER smaller_lanes
#define LARGER larger_lanes
#else
typedef float real_t;
typedef int truth_t;
#define SMALLER smaller
#define LARGER larger
#endif

typedef struct {
    real_t x;
    real_t y;
    real_t z;
} point_t;

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

INLINED point_t choose_point(const truth_t is_first, const point_t a, const point_t b)
{
    const point_t result = {is_first ? a.x : b.x, is_first ? a.y : b.y, is_first ? a.z : b.z};
    return result;
}

// The order of corners, whatever the triangle they are taken from.
INLINED truth_t comes_before(const point_t a, const point_t b)
{
    return (a.x < b.x) | ((a.x == b.x) & ((a.y < b.y) | ((a.y == b.y) & (a.z < b.z))));
}

// From an edge, the same number from either end.
INLINED real_t distance_squared_to_edge(const point_t one, const point_t other)
{
    const truth_t swap = comes_before(other, one);
    const point_t begin = choose_point(swap, other, one);
    const point_t along = difference_of(choose_point(swap, one, other), begin);
    // Written so that the NaN of an edge without length ends at the beginning.
    const real_t unlimited = -dot_of(begin, along) / dot_of(along, along);
    const real_t share = SMALLER(LARGER(unlimited, (real_t)(0.0f)), (real_t)(1.0f));
    const point_t nearest = {begin.x + share * along.x, begin.y + share * along.y, begin.z + share * along.z};
    return dot_of(nearest, nearest);
}

// The nearest point is on an edge, or in the middle. There it is the weighted sum of corners that is perpendicular to the
// triangle; whatever rounding does to the weights, as long as none is negative the point is one of the triangle, so that
// the distance is never too small.
INLINED real_t distance_squared_to_triangle(const point_t a, const point_t b, const point_t c)
{
    const real_t to_edges = SMALLER(
        distance_squared_to_edge(a, b), SMALLER(distance_squared_to_edge(b, c), distance_squared_to_edge(c, a)));
    const point_t normal = cross_of(difference_of(b, a), difference_of(c, a));
    const real_t weight_a = dot_of(normal, cross_of(b, c));
    const real_t weight_b = dot_of(normal, cross_of(c, a));
    const real_t weight_c = dot_of(normal, cross_of(a, b));
    const real_t sum = weight_a + weight_b + weight_c;
    const truth_t is_inside = (weight_a >= 0.0f) & (weight_b >= 0.0f) & (weight_c >= 0.0f) & (sum > 0.0f);
    const real_t share_a = weight_a / sum;
    const real_t share_b = weight_b / sum;
    const real_t share_c = weight_c / sum;
    const point_t nearest = {
        share_a * a.x + share_b * b.x + share_c * c.x, share_a * a.y + share_b * b.y + share_c * c.y,
        share_a * a.z + share_b * b.z + share_c * c.z};
    const real_t to_middle = is_inside ? dot_of(nearest, nearest) : to_edges;
    return SMALLER(to_middle, to_edges);
}
