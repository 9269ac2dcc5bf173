// How far the zero point is from a triangle.

#include "numeric.cl"

// The order of corners, whatever the triangle they are taken from.
bool comes_before(const float3 a, const float3 b)
{
    return a.x < b.x || (a.x == b.x && (a.y < b.y || (a.y == b.y && a.z < b.z)));
}

// From an edge, the same number from either end.
float distance_squared_to_edge(const float3 one, const float3 other)
{
    const bool swap = comes_before(other, one);
    const float3 begin = swap ? other : one;
    const float3 along = (swap ? one : other) - begin;
    // Written so that the NaN of an edge without length ends at the beginning.
    const float share = smaller(larger(-dot(begin, along) / dot(along, along), 0.0f), 1.0f);
    const float3 nearest = begin + share * along;
    return dot(nearest, nearest);
}

// The nearest point is on an edge, or in the middle. There it is the weighted sum of corners that is perpendicular to the
// triangle; whatever rounding does to the weights, as long as none is negative the point is one of the triangle, so that
// the distance is never too small.
float distance_squared_to_triangle(const float3 a, const float3 b, const float3 c)
{
    const float to_edges = smaller(
        distance_squared_to_edge(a, b), smaller(distance_squared_to_edge(b, c), distance_squared_to_edge(c, a)));
    const float3 normal = cross(b - a, c - a);
    const float weight_a = dot(normal, cross(b, c));
    const float weight_b = dot(normal, cross(c, a));
    const float weight_c = dot(normal, cross(a, b));
    const float sum = weight_a + weight_b + weight_c;
    if (!(weight_a >= 0.0f && weight_b >= 0.0f && weight_c >= 0.0f && sum > 0.0f)) {
        return to_edges;
    }
    const float3 nearest = (weight_a / sum) * a + (weight_b / sum) * b + (weight_c / sum) * c;
    return smaller(dot(nearest, nearest), to_edges);
}
