// The face that faces a point most directly, and the nearest vertex, by clbvh/integrations/trimesh/nearest.py.

#include "structs.cl"
#include "triangles/closest.cl"

// Squared distances are equal when they differ by less than this share: a thousand roundings of float64.
#define ROUNDING_SHARE 0x1p-42

// Largest tolerance of squared distances, as a share of them: next to the surface, the tolerance that trimesh adds to
// squares would return points that are not the closest.
#define LARGEST_SHARE 0x1p-20

// Cosines are equal when they differ by less than this: those of coplanar faces differ by roundings.
#define SAME_COSINE 0x1p-42

// Farther away than this many times half the mesh's size, the faces around differ by less than rounding, and a point
// keeps its face; and the vertices do, so the nearest one is found from that distance.
#define FAR_SHARE 0x1p20

// Boxes hold the vertices as float32 has them: a vertex of the file is this far outside at most, in local units, where
// no coordinate is above 1.
#define BOX_SLACK 0x1p-23

// A mesh in the file's coordinates, with the scale and the centre of local ones.
typedef struct {
    const double (*vertices)[3];
    const int (*faces)[3];
    double3 centre;
    double scale;
} mesh_t;

static double3 load_corner(const mesh_t *mesh, const long face, const int corner)
{
    return vload3(0, mesh->vertices[mesh->faces[face][corner]]);
}

// A face as a point sees it: its closest point, and the cosine between its normal and the way to the point; -2 for a
// triangle without a normal.
typedef struct {
    triangle_point_t closest;
    double facing;
} sight_t;

static sight_t see(const mesh_t *mesh, const double3 point, const long face)
{
    const double3 a = (load_corner(mesh, face, 0) - point) * mesh->scale;
    const double3 b = (load_corner(mesh, face, 1) - point) * mesh->scale;
    const double3 c = (load_corner(mesh, face, 2) - point) * mesh->scale;
    const triangle_point_t closest = closest_on_triangle(a, b, c);
    const double3 normal = cross3(b - a, c - a);
    const double length = sqrt(dot3(normal, normal));
    if (!(length > 0.0)) {
        return (sight_t){closest, -2.0};
    }
    const double3 way = closest.weights.x * a + closest.weights.y * b + closest.weights.z * c;
    return (sight_t){closest, -dot3(normal, way) / (length * sqrt(closest.squared))};
}

// Replaces each face by the one that faces the point most directly, see `choose_facing`.
//
// point_ids, begins, around  see `CornerFaces`
// squared_tolerance   of squared distances, in local units
loop void choose(
    const long count, const double points[count][3], const long vertex_count, const double vertices[vertex_count][3],
    const long face_count, const int faces[face_count][3], const double scale, const double centre[3],
    const long point_ids[vertex_count], const long begin_count, const long begins[begin_count],
    const long around[3 * face_count], const double squared_tolerance, double distances[count],
    double closest_points[count][3], int prim_ids[count])
{
    const mesh_t mesh = {vertices, faces, vload3(0, centre), scale};
    for (long index = 0; index < count; index++) {
        const int own = prim_ids[index];
        const double3 point = vload3(0, points[index]);
        if (own == NO_PRIM || !(largest_size((point - mesh.centre) * scale) < FAR_SHARE)) {
            continue;
        }
        const sight_t sight = see(&mesh, point, own);
        double least = sight.closest.squared;
        if (least <= squared_tolerance) {
            continue;
        }
        const double equal =
            most_of(least_of(squared_tolerance, least * LARGEST_SHARE), least * ROUNDING_SHARE);
        long best = own;
        sight_t of_best = sight;
        for (int corner = 0; corner < 3; corner++) {
            const long id = point_ids[faces[own][corner]];
            for (long slot = begins[id]; slot < begins[id + 1]; slot++) {
                const long face = around[slot];
                if (face == own) {
                    continue;
                }
                const sight_t other = see(&mesh, point, face);
                const double squared = other.closest.squared;
                if (!(squared < least + equal)) {
                    continue;
                }
                const bool is_nearer = squared <= least - equal;
                const bool is_equal = fabs(other.facing - of_best.facing) <= SAME_COSINE && face < best;
                if (is_nearer || is_equal || other.facing > of_best.facing + SAME_COSINE) {
                    best = face;
                    of_best = other;
                    least = least_of(least, squared);
                }
            }
        }
        if (best == own) {
            continue;
        }
        prim_ids[index] = best;
        distances[index] = sqrt(of_best.closest.squared) / scale;
        const double3 origin = load_corner(&mesh, best, 0);
        const double3 to_second = load_corner(&mesh, best, 1) - origin;
        const double3 to_third = load_corner(&mesh, best, 2) - origin;
        const double3 weights = of_best.closest.weights;
        vstore3(origin + (weights.y * to_second + weights.z * to_third), index, closest_points[0]);
    }
}

// The nearest vertex so far, and its squared distance in local units.
typedef struct {
    double squared;
    long vertex;
} nearest_t;

static void try_vertex(const mesh_t *mesh, const double3 local_point, const long vertex, nearest_t *nearest)
{
    const double3 away = (vload3(0, mesh->vertices[vertex]) - mesh->centre) * mesh->scale - local_point;
    const double squared = dot3(away, away);
    if (squared < nearest->squared || (squared == nearest->squared && vertex < nearest->vertex)) {
        *nearest = (nearest_t){squared, vertex};
    }
}

// The distance from a point to a node's box.
static double distance_to_box(const row_node_t *node, const double3 point)
{
    double3 away;
    for (int axis = 0; axis < 3; axis++) {
        const double below = (double)node->aabb_min[axis] - point[axis];
        const double above = point[axis] - (double)node->aabb_max[axis];
        away[axis] = most_of(most_of(below, above), 0.0);
    }
    return sqrt(dot3(away, away));
}

// A node that waits, and its distance from the point.
typedef struct {
    long node;
    double near;
} entry_t;

// Writes the nearest vertex of each point.
//
// loose               vertices without a face
// stack               an entry for each level of the tree, and two
loop void find_vertices(
    const long count, const double points[count][3], const long vertex_count, const double vertices[vertex_count][3],
    const long face_count, const int faces[face_count][3], const double scale, const double centre[3],
    const long node_count, const row_node_t nodes[node_count], const int prim_ids[face_count], const long loose_count,
    const long loose[loose_count], const long stack_size, long stack[stack_size][2], long vertex_ids[count])
{
    const mesh_t mesh = {vertices, faces, vload3(0, centre), scale};
    entry_t *entries = (entry_t *)stack;
    for (long index = 0; index < count; index++) {
        double3 local_point = (vload3(0, points[index]) - mesh.centre) * scale;
        const double size = largest_size(local_point);
        local_point *= size > FAR_SHARE ? FAR_SHARE / size : 1.0;
        nearest_t nearest = {INFINITY, -1};
        for (long number = 0; number < loose_count; number++) {
            try_vertex(&mesh, local_point, loose[number], &nearest);
        }
        // Boxes farther away than this hold no nearer vertex.
        double limit = sqrt(nearest.squared) + BOX_SLACK;
        entries[0] = (entry_t){0, 0.0};
        for (long height = 1; height > 0;) {
            const entry_t entry = entries[--height];
            const row_node_t *node = &nodes[entry.node];
            if (entry.near > limit) {
                continue;
            }
            if (node->count > 0) {
                for (long slot = node->first; slot < node->first + node->count; slot++) {
                    for (int corner = 0; corner < 3; corner++) {
                        try_vertex(&mesh, local_point, faces[prim_ids[slot]][corner], &nearest);
                    }
                }
                limit = sqrt(nearest.squared) + BOX_SLACK;
                continue;
            }
            const entry_t left = {node->first, distance_to_box(&nodes[node->first], local_point)};
            const entry_t right = {node->first + 1, distance_to_box(&nodes[node->first + 1], local_point)};
            // The nearer one is on top.
            const bool is_left_nearer = left.near < right.near;
            entries[height++] = is_left_nearer ? right : left;
            entries[height++] = is_left_nearer ? left : right;
        }
        vertex_ids[index] = nearest.vertex;
    }
}
