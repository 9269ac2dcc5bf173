// The point of an ellipsoid that is closest to another point, and its distance: a sphere under an affine map.
//
// The closest point x of y has x_i = l_i^2 y_i / (t + l_i^2) with the one t above -l_min^2 for which it is on the
// ellipsoid (Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013). With t = l_min^2
// (s - 1) the shares x_i / l_i are pulls_i / (s + above_i), and s > 0 keeps its digits where it is small. One over the
// length of the shares is concave in s, so Newton's steps, which begin where a share alone is 1, never pass the s where
// that length is 1 (More and Sorensen, "Computing a trust region step", 1983).
//
// Devices use floats. What is computed again on the host uses doubles: it defines IN_DOUBLES, and includes this file
// again.

#include "math/numeric.cl"

// Steps are as many as the numbers can use; five to seven are usual.
#if defined(IN_DOUBLES)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define span_t double
#define span3_t double3
#define SMALLER_SPAN least_of
#define LARGER_SPAN most_of
#define ELLIPSOID_STEPS 64
#else
#define span_t float
#define span3_t float3
#define SMALLER_SPAN smaller
#define LARGER_SPAN larger
#define ELLIPSOID_STEPS 12
#endif

OVERLOADED span_t sum_of_squares(const span3_t v)
{
    return v.x * v.x + v.y * v.y + v.z * v.z;
}

// A coordinate's share in the half length of its axis; 0 for a coordinate of zero.
OVERLOADED span3_t shares_at(const span3_t pulls, const span3_t above, const span_t shift)
{
    const span3_t shares = pulls / (shift + above);
    return (span3_t)(pulls.x > 0 ? shares.x : 0, pulls.y > 0 ? shares.y : 0, pulls.z > 0 ? shares.z : 0);
}

// The closest point of an ellipsoid around zero whose axes are those of the coordinates, in half lengths of its axes.
// Of two at the same distance, the one off the plane across the first shortest axis.
//
// position            not negative
// lengths             half lengths of the axes
OVERLOADED span3_t closest_shares(const span3_t position, const span3_t lengths)
{
    const span_t least = SMALLER_SPAN(lengths.x, SMALLER_SPAN(lengths.y, lengths.z));
    const span3_t ratios = lengths / least;
    const span3_t above = (ratios - 1) * (ratios + 1);
    const span3_t pulls = ratios * (position / least);
    const span3_t starts = pulls - above;
    span_t shift = LARGER_SPAN(LARGER_SPAN(starts.x, LARGER_SPAN(starts.y, starts.z)), 0);
    span3_t shares = shares_at(pulls, above, shift);
    span_t squared = sum_of_squares(shares);
    for (int i = 0; i < ELLIPSOID_STEPS && squared > 1; i++) {
        // Shares of zero have no part in the slope, though their denominators may be zero, too.
        const span3_t slopes = shares * shares / (shift + above);
        const span_t slope =
            (shares.x > 0 ? slopes.x : 0) + (shares.y > 0 ? slopes.y : 0) + (shares.z > 0 ? slopes.z : 0);
        const span_t next = shift + (sqrt(squared) - 1) * squared / slope;
        if (!(next > shift)) {
            break;
        }
        shift = next;
        shares = shares_at(pulls, above, shift);
        squared = sum_of_squares(shares);
    }
    if (shift == 0 && squared < 1) {
        // From the middle of the ellipsoid: off the plane across the shortest axis, to either side.
        const span_t rest = sqrt(1 - squared);
        if (lengths.x == least) {
            shares.x = rest;
        } else if (lengths.y == least) {
            shares.y = rest;
        } else {
            shares.z = rest;
        }
        return shares;
    }
    // Onto the ellipsoid: the distance is then never too small.
    return shares / sqrt(squared);
}

OVERLOADED span_t distance_squared_to_ellipsoid(const span3_t position, const span3_t lengths)
{
    return sum_of_squares(position - closest_shares(position, lengths) * lengths);
}

#undef span_t
#undef span3_t
#undef SMALLER_SPAN
#undef LARGER_SPAN
#undef ELLIPSOID_STEPS
