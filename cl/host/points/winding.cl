// Moments of the nodes of a tree over triangles, by clbvh/trace/points/winding.py; cl/kernels/winding.cl says which.

#include "math/doubles.cl"

#define NODE_NUMBERS 26

// Of a node: the sum of areas and of positions by them, the box, and moments around the centre, of which the first
// index is that of the normal.
typedef struct {
    double area;
    double3 weighted;
    double3 lower;
    double3 upper;
    double3 centre;
    double radius;
    double3 dipole;
    double second[3][3];
    double third[3][3][3];
} moments_t;

INLINED double3 least_of3(const double3 a, const double3 b)
{
    return (double3)(least_of(a.x, b.x), least_of(a.y, b.y), least_of(a.z, b.z));
}

// Moments of nothing, around the centre of the areas, or of the box where there are none.
static void begin_moments(moments_t *sum)
{
    const double3 middle = 0.5 * (sum->lower + sum->upper);
    sum->centre = sum->area > 0.0 ? sum->weighted / sum->area : middle;
    const double3 reach = 0.5 * (sum->upper - sum->lower) + fabs(sum->centre - middle);
    sum->radius = sqrt(dot3(reach, reach));
    sum->dipole = (double3)(0.0);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            sum->second[i][j] = 0.0;
            for (int k = 0; k < 3; k++) {
                sum->third[i][j][k] = 0.0;
            }
        }
    }
}

// Adds moments around another centre.
static void add_moments(moments_t *sum, const moments_t *own)
{
    const double3 shift = own->centre - sum->centre;
    sum->dipole += own->dipole;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            sum->second[i][j] += own->second[i][j] + own->dipole[i] * shift[j];
            for (int k = 0; k < 3; k++) {
                sum->third[i][j][k] += own->third[i][j][k] + own->second[i][j] * shift[k]
                    + own->second[i][k] * shift[j] + own->dipole[i] * shift[j] * shift[k];
            }
        }
    }
}

// Adds the moments of a triangle: integrals of polynomials over it, by the corners.
static void add_triangle(moments_t *sum, const double3 corners[3])
{
    const double3 ways[3] = {corners[0] - sum->centre, corners[1] - sum->centre, corners[2] - sum->centre};
    const double3 normal = 0.5 * cross3(corners[1] - corners[0], corners[2] - corners[0]);
    const double3 total = ways[0] + ways[1] + ways[2];
    sum->dipole += normal;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            sum->second[i][j] += normal[i] * total[j] / 3.0;
            for (int k = 0; k < 3; k++) {
                double squares = total[j] * total[k];
                for (int corner = 0; corner < 3; corner++) {
                    squares += ways[corner][j] * ways[corner][k];
                }
                sum->third[i][j][k] += normal[i] * squares / 12.0;
            }
        }
    }
}

static void write_moments(const moments_t *own, float *row)
{
    const double(*third)[3][3] = own->third;
    const int pairs[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {0, 2}, {1, 2}};
    const int triples[10][3] = {{0, 0, 0}, {1, 1, 1}, {2, 2, 2}, {0, 0, 1}, {0, 0, 2},
                                {0, 1, 1}, {1, 1, 2}, {0, 2, 2}, {1, 2, 2}, {0, 1, 2}};
    row[3] = (float)own->radius;
    for (int i = 0; i < 3; i++) {
        double trace = 0.0;
        for (int j = 0; j < 3; j++) {
            trace += 2.0 * third[j][j][i] + third[i][j][j];
        }
        row[i] = (float)own->centre[i];
        row[4 + i] = (float)own->dipole[i];
        row[13 + i] = (float)trace;
    }
    for (int pair = 0; pair < 6; pair++) {
        const int i = pairs[pair][0], j = pairs[pair][1];
        row[7 + pair] = (float)(0.5 * (own->second[i][j] + own->second[j][i]));
    }
    for (int triple = 0; triple < 10; triple++) {
        const int i = triples[triple][0], j = triples[triple][1], k = triples[triple][2];
        const double orders = i == k ? 1.0 : i == j || j == k ? 3.0 : 6.0;
        row[16 + triple] = (float)(orders / 3.0 * (third[i][j][k] + third[j][i][k] + third[k][i][j]));
    }
}

// Writes a node and all below it, and returns its moments. Trees are at most 64 levels deep.
static void fit_node(const int *links, const double *corners, const long node, float *nodes, moments_t *own)
{
    const long first = links[2 * node], end = first + links[2 * node + 1];
    own->area = 0.0;
    own->weighted = (double3)(0.0);
    own->lower = (double3)(INFINITY);
    own->upper = -own->lower;
    if (end == first) {
        moments_t children[2];
        for (int child = 0; child < 2; child++) {
            fit_node(links, corners, first + child, nodes, &children[child]);
            own->area += children[child].area;
            own->weighted += children[child].weighted;
            own->lower = least_of3(own->lower, children[child].lower);
            own->upper = -least_of3(-own->upper, -children[child].upper);
        }
        begin_moments(own);
        add_moments(own, &children[0]);
        add_moments(own, &children[1]);
    } else {
        for (long triangle = first; triangle < end; triangle++) {
            const double3 a = vload3(3 * triangle, corners), b = vload3(3 * triangle + 1, corners),
                          c = vload3(3 * triangle + 2, corners);
            const double3 normal = 0.5 * cross3(b - a, c - a);
            const double area = sqrt(dot3(normal, normal));
            own->area += area;
            own->weighted += area / 3.0 * (a + b + c);
            own->lower = least_of3(least_of3(own->lower, a), least_of3(b, c));
            own->upper = -least_of3(least_of3(-own->upper, -a), least_of3(-b, -c));
        }
        begin_moments(own);
        for (long triangle = first; triangle < end; triangle++) {
            const double3 placed[3] = {
                vload3(3 * triangle, corners), vload3(3 * triangle + 1, corners), vload3(3 * triangle + 2, corners)};
            add_triangle(own, placed);
        }
    }
    write_moments(own, nodes + NODE_NUMBERS * node);
}

// Writes the moments of all nodes.
//
// links       fields first and count of the nodes
// corners     of the triangles, in the order of the leaves
loop void fit_moments(
    const long count, const int links[count][2], const long corner_count, const double corners[corner_count],
    float nodes[count][26])
{
    moments_t root;
    if (count > 0) {
        fit_node(links[0], corners, 0, nodes[0], &root);
    }
}
