// The distance of a point from an ellipsoid.

#include "math/vectors.cl"

// Steps to the closest point of an ellipsoid: as many as float32 can use.
#define ELLIPSOID_STEPS 12

// The square of a coordinate's share in the half length of its axis; 0 for a coordinate of zero.
INLINED float3 shares_at(const float3 pulls, const float3 above, const float shift)
{
    const float3 shares = pulls / (shift + above);
    return (float3)(
        pulls.x > 0.0f ? shares.x : 0.0f, pulls.y > 0.0f ? shares.y : 0.0f, pulls.z > 0.0f ? shares.z : 0.0f);
}

// The squared distance of a point from an ellipsoid around zero whose axes are those of the coordinates.
//
// The closest point x of y has x_i = l_i^2 y_i / (t + l_i^2) with the one t above -l_min^2 for which it is on the
// ellipsoid (Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013). With t = l_min^2
// (s - 1) the shares x_i / l_i are pulls_i / (s + above_i), and s > 0 keeps its digits where it is small. One over the
// length of the shares is concave in s, so Newton's steps, which begin where a share alone is 1, never pass the s where
// that length is 1 (More and Sorensen, "Computing a trust region step", 1983).
//
// position : not negative
// lengths  : half lengths of the axes
INLINED float distance_squared_to_ellipsoid(const float3 position, const float3 lengths)
{
    const float least = smaller(lengths.x, smaller(lengths.y, lengths.z));
    const float3 ratios = lengths / least;
    const float3 above = (ratios - 1.0f) * (ratios + 1.0f);
    const float3 pulls = ratios * (position / least);
    const float3 starts = pulls - above;
    float shift = larger(larger(starts.x, larger(starts.y, starts.z)), 0.0f);
    float3 shares = shares_at(pulls, above, shift);
    float squared = dot_product(shares, shares);
    for (int i = 0; i < ELLIPSOID_STEPS && squared > 1.0f; i++) {
        const float size = sqrt(squared);
        // Shares of zero have no part in the slope, though their denominators may be zero, too.
        const float3 slopes = shares * shares / (shift + above);
        const float slope = (shares.x > 0.0f ? slopes.x : 0.0f) + (shares.y > 0.0f ? slopes.y : 0.0f)
            + (shares.z > 0.0f ? slopes.z : 0.0f);
        const float next = shift + (size - 1.0f) * squared / slope;
        if (!(next > shift)) {
            break;
        }
        shift = next;
        shares = shares_at(pulls, above, shift);
        squared = dot_product(shares, shares);
    }
    // From the middle of the ellipsoid, the closest point is off the plane across the shortest axis, to either side.
    if (shift == 0.0f && squared < 1.0f) {
        const float rest = sqrt(1.0f - squared);
        if (lengths.x == least) {
            shares.x = rest;
        } else if (lengths.y == least) {
            shares.y = rest;
        } else {
            shares.z = rest;
        }
    } else {
        // Onto the ellipsoid: the distance is then never too small.
        shares /= sqrt(squared);
    }
    const float3 way = position - shares * lengths;
    return dot_product(way, way);
}
