// The generalized winding number of each point: how often triangles, closed or not, go around it. Nodes that are far
// away are expanded around their centre, up to the second order (Barill, Dickson, Schmidt, Levin and Jacobson, "Fast
// winding numbers for soups and clouds", 2018); the triangles of others are summed exactly (Jacobson, Kavan and
// Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding numbers", 2013).
//
// nodes[node_count][NODE_NUMBERS]  see below; written by cl/host/points/winding.cl
// links[node_count][2]             fields first and count of a row_node_t
// corners[][3][3]                  of the triangles, in the order of the leaves
// points[point_count][3]           in the same local coordinates, as all others
// accuracy                         a node is far if its centre is farther than this many radii
// windings[point_count]            written
//
// LANES points, neighbours in memory, walk the tree together: a compiler for CPUs computes them at once, in vectors.
// Each answer is that of the point alone.
//
// Work-items: (point_count / LANES), rounded up, and up to whole work-groups.

#include "math/trigonometry.cl"
#include "math/numeric.cl"

#ifndef LANES
#define LANES 8
#endif

#ifndef STACK_SIZE
#define STACK_SIZE 64
#endif

// The numbers of a node: its centre, its radius, and moments of its triangles, which are integrals over their areas of
// the normal n and of the way d from the centre.
#define NODE_NUMBERS 26
#define RADIUS 3
// n
#define DIPOLE 4
// n_i d_j, symmetric: xx, yy, zz, xy, xz, yz
#define SECOND 7
// 2 n_i d_i d + n d d
#define TRACE 13
// n_i d_j d_k, symmetric: xxx, yyy, zzz, xxy, xxz, xyy, yyz, xzz, yzz, xyz, times the number of different orders
#define THIRD 16

// For each lane; its body is without branches, and nothing in it is a vector.
#define FOR_LANES for (int lane = 0; lane < LANES; lane++)

// The points of a work-item, and their sums: Kahan's, with what rounding has left off.
typedef struct {
    float x[LANES];
    float y[LANES];
    float z[LANES];
    float sum[LANES];
    float rest[LANES];
} lanes_t;

// Adds terms in the lanes of a mask.
INLINED void add_terms(lanes_t *lanes, const uint mask, const float terms[LANES])
{
    FOR_LANES
    {
        const float term = terms[lane] - lanes->rest[lane], grown = lanes->sum[lane] + term;
        const float rest = (grown - lanes->sum[lane]) - term;
        const bool is_on = mask >> lane & 1u;
        lanes->rest[lane] = is_on ? rest : lanes->rest[lane];
        lanes->sum[lane] = is_on ? grown : lanes->sum[lane];
    }
}

// The lanes that are farther away from a node than some of its radii.
INLINED uint find_far(const lanes_t *lanes, const global float *node, const float accuracy)
{
    const float reach = accuracy * node[RADIUS];
    uint far = 0u;
    FOR_LANES
    {
        const float x = node[0] - lanes->x[lane], y = node[1] - lanes->y[lane], z = node[2] - lanes->z[lane];
        const float squared = x * x + y * y + z * z;
        far |= (uint)(squared > reach * reach && squared > 0.0f) << lane;
    }
    return far;
}

// Adds four pi times the winding number of a node.
INLINED void expand_node(lanes_t *lanes, const uint mask, const global float *node)
{
    const global float *m = node + SECOND, *t = node + THIRD;
    float terms[LANES];
    FOR_LANES
    {
        const float x = node[0] - lanes->x[lane], y = node[1] - lanes->y[lane], z = node[2] - lanes->z[lane];
        const float inverse = 1.0f / square_root(x * x + y * y + z * z);
        const float ux = x * inverse, uy = y * inverse, uz = z * inverse;
        const float dipole = node[DIPOLE] * ux + node[DIPOLE + 1] * uy + node[DIPOLE + 2] * uz;
        const float trace = node[TRACE] * ux + node[TRACE + 1] * uy + node[TRACE + 2] * uz;
        const float mixed = ux * uy * m[3] + ux * uz * m[4] + uy * uz * m[5];
        const float along = ux * ux * m[0] + uy * uy * m[1] + uz * uz * m[2] + 2.0f * mixed;
        const float of_x = ux * (ux * t[0] + uy * t[3] + uz * t[4]) + uy * (uy * t[5] + uz * t[9]) + uz * uz * t[7];
        const float of_y = uy * (uy * t[1] + uz * t[6]) + uz * uz * t[8];
        const float cubic = ux * of_x + uy * of_y + uz * uz * uz * t[2];
        const float second = m[0] + m[1] + m[2] - 3.0f * along, third = 7.5f * cubic - 1.5f * trace;
        terms[lane] = inverse * inverse * (dipole + inverse * (second + inverse * third));
    }
    add_terms(lanes, mask, terms);
}

// Adds the solid angle of a triangle (Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983).
INLINED void add_triangle(lanes_t *lanes, const uint mask, const global float *corners)
{
    float terms[LANES];
    FOR_LANES
    {
        const float x = lanes->x[lane], y = lanes->y[lane], z = lanes->z[lane];
        const float ax = corners[0] - x, ay = corners[1] - y, az = corners[2] - z;
        const float bx = corners[3] - x, by = corners[4] - y, bz = corners[5] - z;
        const float cx = corners[6] - x, cy = corners[7] - y, cz = corners[8] - z;
        const float a = square_root(ax * ax + ay * ay + az * az), b = square_root(bx * bx + by * by + bz * bz),
                    c = square_root(cx * cx + cy * cy + cz * cz);
        const float volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
        const float below = a * b * c + (ax * bx + ay * by + az * bz) * c + (ax * cx + ay * cy + az * cz) * b
            + (bx * cx + by * cy + bz * cz) * a;
        terms[lane] = 2.0f * arctangent2(volume, below);
    }
    add_terms(lanes, mask, terms);
}

kernel void winding(
    const global float *restrict nodes, const global int *restrict links, const global float *restrict corners,
    const global float *restrict points, const int point_count, const float accuracy, global float *restrict windings)
{
    const int begin = (int)get_global_id(0) * LANES;
    if (begin >= point_count) {
        return;
    }
    lanes_t lanes;
    FOR_LANES
    {
        const int point = min(begin + lane, point_count - 1);
        lanes.x[lane] = points[3L * point];
        lanes.y[lane] = points[3L * point + 1];
        lanes.z[lane] = points[3L * point + 2];
        lanes.sum[lane] = lanes.rest[lane] = 0.0f;
    }
    int stack[STACK_SIZE];
    uint masks[STACK_SIZE];
    int depth = 0, node = 0;
    uint mask = (1u << LANES) - 1u;
    while (true) {
        const global float *row = nodes + (long)NODE_NUMBERS * node;
        const int first = links[2 * node], count = links[2 * node + 1];
        const uint far = mask & find_far(&lanes, row, accuracy);
        if (far != 0u) {
            expand_node(&lanes, far, row);
        }
        mask &= ~far;
        if (mask != 0u && count == 0) {
            stack[depth] = first + 1;
            masks[depth++] = mask;
            node = first;
            continue;
        }
        if (mask != 0u) {
            for (int triangle = first; triangle < first + count; triangle++) {
                add_triangle(&lanes, mask, corners + 9L * triangle);
            }
        }
        if (depth == 0) {
            break;
        }
        node = stack[--depth];
        mask = masks[depth];
    }
    FOR_LANES
    {
        if (begin + lane < point_count) {
            windings[begin + lane] = lanes.sum[lane] * (0.25f / PI);
        }
    }
}
