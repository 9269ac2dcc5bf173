// The part of a surface that lies in boxes of nodes which do not hold it, by clbvh/stats/overlap.py.

#include "structs.cl"
#include "math/doubles.cl"

// A triangle that is clipped by six planes gains at most one vertex from each plane.
#define MOST_VERTICES 9

// A plane, convex polygon.
typedef struct {
    int size;
    double3 at[MOST_VERTICES];
} polygon_t;

// A node that overlaps or holds the triangle, and the part of the triangle inside its box, in the memory of doubles.
typedef struct {
    long node;
    long size;
    double at[MOST_VERTICES][3];
} pending_t;

// 0 for fewer than three vertices.
static double area_of(const polygon_t *polygon)
{
    double3 sum = (double3)(0.0);
    for (int corner = 1; corner < polygon->size - 1; corner++) {
        sum += cross3(polygon->at[corner] - polygon->at[0], polygon->at[corner + 1] - polygon->at[0]);
    }
    return 0.5 * sqrt(dot3(sum, sum));
}

static bool misses(const polygon_t *polygon, const row_node_t *node)
{
    double3 lower = polygon->at[0];
    double3 upper = polygon->at[0];
    for (int corner = 1; corner < polygon->size; corner++) {
        lower = min(lower, polygon->at[corner]);
        upper = max(upper, polygon->at[corner]);
    }
    for (int axis = 0; axis < 3; axis++) {
        if (lower[axis] > node->aabb_max[axis] || upper[axis] < node->aabb_min[axis]) {
            return true;
        }
    }
    return false;
}

// Clips a polygon to a plane: inside is where sign * coordinate <= plane.
static polygon_t clip_to_plane(const polygon_t *polygon, const int axis, const double sign, const double plane)
{
    polygon_t clipped;
    clipped.size = 0;
    for (int corner = 0; corner < polygon->size; corner++) {
        const double3 own = polygon->at[corner];
        const double3 next = polygon->at[corner + 1 < polygon->size ? corner + 1 : 0];
        const double here = sign * own[axis] - plane;
        const double there = sign * next[axis] - plane;
        if (here <= 0.0) {
            clipped.at[clipped.size++] = own;
        }
        if ((here < 0.0 && there > 0.0) || (there < 0.0 && here > 0.0)) {
            double3 between = own + here / (here - there) * (next - own);
            between[axis] = sign * plane;
            clipped.at[clipped.size++] = between;
        }
    }
    return clipped;
}

// Clips a polygon to a node's box (Sutherland and Hodgman, "Reentrant polygon clipping", 1974).
static polygon_t clip(const polygon_t *polygon, const row_node_t *node)
{
    polygon_t clipped = *polygon;
    // Most polygons miss the box, which their bounds tell.
    if (misses(polygon, node)) {
        clipped.size = 0;
        return clipped;
    }
    for (int axis = 0; axis < 3; axis++) {
        for (int is_upper = 0; is_upper < 2; is_upper++) {
            const double sign = is_upper ? 1.0 : -1.0;
            const double plane = sign * (is_upper ? node->aabb_max[axis] : node->aabb_min[axis]);
            bool is_cut = false;
            for (int corner = 0; corner < clipped.size; corner++) {
                is_cut |= sign * clipped.at[corner][axis] > plane;
            }
            if (is_cut) {
                clipped = clip_to_plane(&clipped, axis, sign, plane);
                if (clipped.size < 3) {
                    clipped.size = 0;
                    return clipped;
                }
            }
        }
    }
    return clipped;
}

static void push(pending_t *pending, const int node, const polygon_t *polygon)
{
    pending->node = node;
    pending->size = polygon->size;
    for (int corner = 0; corner < polygon->size; corner++) {
        vstore3(polygon->at[corner], corner, &pending->at[0][0]);
    }
}

static polygon_t polygon_of(const pending_t *pending)
{
    polygon_t polygon;
    polygon.size = (int)pending->size;
    for (int corner = 0; corner < polygon.size; corner++) {
        polygon.at[corner] = vload3(0, pending->at[corner]);
    }
    return polygon;
}

// Writes the parent of each node but the root, and the leaf that owns each slot of the primitives.
loop void find_owners(
    const long count, const row_node_t nodes[count], int parents[count], const long prim_count, int owners[prim_count])
{
    for (long node = 0; node < count; node++) {
        const int first = nodes[node].first;
        if (nodes[node].count == 0) {
            parents[first] = parents[first + 1] = (int)node;
        }
        for (int slot = first; slot < first + nodes[node].count; slot++) {
            owners[slot] = (int)node;
        }
    }
}

// Writes the summed costs times areas of the overlaps of some triangles, and the triangles' own area.
//
// slots               the triangles, by their slots in `prim_ids`
// costs               of a visit to each node
// parents, owners     see `find_owners`; -1 of the root
// held_leaf           the last leaf whose triangle each node was found to hold, which is no overlap; -1 before
// stack               scratch
loop void sum_overlaps(
    const long vertex_count, const float vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], const long prim_count, const int prim_ids[prim_count], const long slot_count,
    const long slots[slot_count], const long count, const row_node_t nodes[count], const double costs[count],
    const int parents[count], const int owners[prim_count], int held_leaf[count], double *stack, double sums[2])
{
    pending_t *pending = (pending_t *)stack;
    double overlap = 0.0;
    double total_area = 0.0;
    for (long i = 0; i < slot_count; i++) {
        polygon_t triangle;
        triangle.size = 3;
        for (int corner = 0; corner < 3; corner++) {
            triangle.at[corner] = convert_double3(load3(vertices[faces[prim_ids[slots[i]]][corner]]));
        }
        const double whole = area_of(&triangle);
        total_area += whole;
        if (whole == 0.0) {
            continue;
        }
        const int leaf = owners[slots[i]];
        for (int node = leaf; node >= 0 && held_leaf[node] != leaf; node = parents[node]) {
            held_leaf[node] = leaf;
        }
        if (nodes[0].count > 0) {
            continue;  // the root is the only node, and holds every triangle
        }
        int stack_size = 1;
        push(pending, 0, &triangle);
        while (stack_size > 0) {
            const pending_t *last = pending + --stack_size;
            const polygon_t polygon = polygon_of(last);
            const int first = nodes[last->node].first;
            for (int node = first; node < first + 2; node++) {
                polygon_t part = polygon;
                if (held_leaf[node] != leaf) {
                    part = clip(&polygon, &nodes[node]);
                    const double area = area_of(&part);
                    if (area == 0.0) {
                        continue;
                    }
                    overlap += costs[node] * area;
                }
                if (nodes[node].count == 0) {
                    push(pending + stack_size++, node, &part);
                }
            }
        }
    }
    sums[0] = overlap;
    sums[1] = total_area;
}
