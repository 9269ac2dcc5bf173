// The distance of two triangles, and whether they touch.
//
// Triangles are closed sets of points: a common point of any kind is a touch. They may be degenerate to a segment or a
// point.

#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// A determinant of three differences of corners is wrong by less than this share of the product of their largest
// components, and less than the other number. Each of its six products has at most 3 roundings of differences, 2 of
// multiplications and 5 of sums, of 2^-53 each: together less than 60 of them. See Shewchuk, "Adaptive precision
// floating-point arithmetic and fast robust geometric predicates", 1997.
#define DETERMINANT_ERROR 0x1p-46
#define UNDERFLOW 0x1p-1000

// Triangles farther apart than this share of their size touch only if determinants say so for certain.
//
// Proof: take their size to be 1 to 2, so that differences are below 4. If they touch other than by a vertex or two
// edges, an edge pq of one pierces the other one, T, in x. Let one of the five determinants be uncertain: at most 2^-45
// times the product of its rows. If it is that of p and the plane of T, then p is h <= 2^-43 l^2 / n above T, with l
// the longest edge of T and n twice its area, and x is at most r <= n / 2l from an edge of T. As xp stays as low as p,
// it ends above T or passes an edge, at most h away. So the distance of the pieces, vertices to faces and edges to
// edges, is at most sqrt(h r) < 2^-20. If it is that of pq and an edge e of T, look along e: the parallelogram of p and
// q seen from e is at most d = 2^-41. Either pq looks shorter than sqrt(d), and p is that close to T; or its line
// passes e at sqrt(d), and with the same argument so close a piece of T passes p, q, or an edge, at most sqrt(2 d) =
// 2^-20 away.
#define CERTAIN_SHARE 0x1p-18

// Squared distances below this, where the scene is of size 1, lose digits to underflow.
#define LEAST_SQUARED 0x1p-600

// Room for the rounding of a squared distance of boxes.
#define SHRINK (1.0 - 0x1p-50)

// A limit below all squared distances of triangles apart, and what stands for one that is rounded to 0.
#define TOUCH 0x1p-1000
#define APART 0x1p-999

INLINED double3 least_of3(const double3 a, const double3 b)
{
    return (double3)(least_of(a.x, b.x), least_of(a.y, b.y), least_of(a.z, b.z));
}

INLINED double3 most_of3(const double3 a, const double3 b)
{
    return (double3)(most_of(a.x, b.x), most_of(a.y, b.y), most_of(a.z, b.z));
}

// The squared distance of the boxes of two triangles.
INLINED double squared_gap(const double3 a[3], const double3 b[3])
{
    const double3 least_of_a = least_of3(least_of3(a[0], a[1]), a[2]);
    const double3 least_of_b = least_of3(least_of3(b[0], b[1]), b[2]);
    const double3 most_of_a = most_of3(most_of3(a[0], a[1]), a[2]);
    const double3 most_of_b = most_of3(most_of3(b[0], b[1]), b[2]);
    const double3 gap = most_of3(most_of3(least_of_a - most_of_b, (double3)(0.0)), least_of_b - most_of_a);
    return dot3(gap, gap);
}

// The sign of the determinant of three points seen from a fourth; 0 where it is not certain.
INLINED int side_of(const double3 base, const double3 one, const double3 two, const double3 three)
{
    const double3 x = one - base, y = two - base, z = three - base;
    const double volume = dot3(cross3(x, y), z);
    const double error = DETERMINANT_ERROR * largest_size(x) * largest_size(y) * largest_size(z) + UNDERFLOW;
    return volume > error ? 1 : volume < -error ? -1 : 0;
}

// On which sides of the plane of a triangle three corners are.
INLINED int3 find_sides(const double3 t[3], const double3 corners[3])
{
    return (int3)(
        side_of(t[0], t[1], t[2], corners[0]), side_of(t[0], t[1], t[2], corners[1]),
        side_of(t[0], t[1], t[2], corners[2]));
}

INLINED bool is_one_sided(const int3 sides)
{
    return sides.x != 0 && sides.x == sides.y && sides.y == sides.z;
}

// Whether an edge of a triangle passes through another one for certain, given the sides of its corners.
INLINED bool pierces(const double3 corners[3], const int3 sides, const double3 t[3])
{
    for (int first = 0; first < 3; first++) {
        const int second = (first + 1) % 3;
        if (sides[first] * sides[second] < 0) {
            const double3 p = corners[first], q = corners[second];
            const int side = side_of(t[0], t[1], p, q);
            if (side != 0 && side == side_of(t[1], t[2], p, q) && side == side_of(t[2], t[0], p, q)) {
                return true;
            }
        }
    }
    return false;
}

// The least squared distance of three corners from where they are right above or below a triangle; else infinite.
INLINED double above_face(const double3 t[3], const double3 corners[3])
{
    const double3 ab = t[1] - t[0], bc = t[2] - t[1], ca = t[0] - t[2];
    const double3 normal = cross3(ab, bc);
    double least = INFINITY;
    for (int corner = 0; corner < 3; corner++) {
        const double3 from_a = t[0] - corners[corner], from_b = t[1] - corners[corner], from_c = t[2] - corners[corner];
        const double a = dot3(cross3(from_b, bc), normal);
        const double b = dot3(cross3(from_c, ca), normal);
        const double c = dot3(cross3(from_a, ab), normal);
        const double total = a + b + c;
        if (a >= 0.0 && b >= 0.0 && c >= 0.0 && total > 0.0) {
            // To the foot itself, which is in the triangle also where rounding has turned the normal of a thin one.
            const double3 away = from_a + b / total * ab + -c / total * ca;
            least = least_of(least, dot3(away, away));
        }
    }
    return least;
}

INLINED double share_of(const double part, const double whole)
{
    return whole > 0.0 ? least_of(most_of(part / whole, 0.0), 1.0) : 0.0;
}

// The squared distance of two segments; either may be a point.
INLINED double between_edges(const double3 p, const double3 q, const double3 r, const double3 s)
{
    const double3 one = q - p, other = s - r, way = r - p;
    const double3 normal = cross3(one, other);
    // Of the normal, not of dot products, which cancel for edges that are nearly parallel.
    double along = share_of(dot3(cross3(way, other), normal), dot3(normal, normal));
    const double across = share_of(-dot3(way + -along * one, other), dot3(other, other));
    along = share_of(dot3(way + across * other, one), dot3(one, one));
    const double3 away = way + across * other + -along * one;
    return dot3(away, away);
}

// The least squared distance of vertices to faces and of edges to edges: that of triangles apart.
//
// See Ericson, "Real-time collision detection", 2005, 5.1.
INLINED double measure_pieces(const double3 a[3], const double3 b[3])
{
    double squared = least_of(above_face(a, b), above_face(b, a));
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            squared = least_of(squared, between_edges(a[i], a[(i + 1) % 3], b[j], b[(j + 1) % 3]));
        }
    }
    return squared;
}

// Returns the squared distance of two triangles; infinity for one that is not below the limit, and 0 only for triangles
// that touch for certain. Writes whether it may be 0 for all that double can tell.
//
// a, b                three corners each, in a unit that makes the scene about 1
// limit               squared distance; TOUCH where only touches are looked for
INLINED double measure_triangles(const double3 a[3], const double3 b[3], const double limit, bool *is_open)
{
    *is_open = false;
    const double gap = squared_gap(a, b);
    if (gap * SHRINK >= limit) {
        return INFINITY;
    }
    bool may_touch = gap == 0.0;
    if (may_touch) {
        const int3 sides_of_b = find_sides(a, b), sides_of_a = find_sides(b, a);
        may_touch = !is_one_sided(sides_of_b) && !is_one_sided(sides_of_a);
        if (may_touch && (pierces(b, sides_of_b, a) || pierces(a, sides_of_a, b))) {
            return 0.0;
        }
    }
    if (!may_touch && limit <= TOUCH) {
        return INFINITY;
    }
    double squared = measure_pieces(a, b);
    if (!may_touch) {
        squared = most_of(squared, APART);
    } else {
        double size = most_of(largest_size(a[1] - a[0]), largest_size(a[2] - a[0]));
        for (int corner = 0; corner < 3; corner++) {
            size = most_of(size, largest_size(b[corner] - a[0]));
        }
        if (squared <= most_of(CERTAIN_SHARE * CERTAIN_SHARE * size * size, LEAST_SQUARED)) {
            *is_open = true;
            return squared;
        }
    }
    return squared < limit ? squared : INFINITY;
}
