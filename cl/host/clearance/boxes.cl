// Boxes along the surface around the triangles of each node of a tree, by clbvh/trace/clearance/boxes.py.

#include "math/doubles.cl"
#include "structs.cl"

// Writes the parent of each node, and the sum of its triangles' normals, which are as long as these are wide.
loop void sum_normals(
    const long node_count, const row_node_t nodes[node_count], const long prim_count, const int prim_ids[prim_count],
    const long vertex_count, const double vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], int parents[node_count], double normals[node_count][3])
{
    for (long node = node_count - 1; node >= 0; node--) {
        const int first = nodes[node].first;
        double3 sum = (double3)(0.0);
        for (int slot = first; slot < first + nodes[node].count; slot++) {
            const int *face = faces[prim_ids[slot]];
            const double3 a = vload3(0, vertices[face[0]]);
            sum += cross3(vload3(0, vertices[face[1]]) - a, vload3(0, vertices[face[2]]) - a);
        }
        if (nodes[node].count == 0) {
            parents[first] = parents[first + 1] = (int)node;
            sum = vload3(0, normals[first]) + vload3(0, normals[first + 1]);
        }
        vstore3(sum, node, normals[0]);
    }
}

// Writes where the triangles of each node begin and end along its axes.
//
// lower, upper        infinite before
loop void measure_nodes(
    const long node_count, const row_node_t nodes[node_count], const long prim_count, const int prim_ids[prim_count],
    const long vertex_count, const double vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], const int parents[node_count], const float axes[node_count][9],
    double lower[node_count][3], double upper[node_count][3])
{
    for (long leaf = 0; leaf < node_count; leaf++) {
        for (int index = 0; index < 3 * nodes[leaf].count; index++) {
            const int *face = faces[prim_ids[nodes[leaf].first + index / 3]];
            const double3 corner = vload3(0, vertices[face[index % 3]]);
            for (long node = leaf;; node = parents[node]) {
                for (int row = 0; row < 3; row++) {
                    const float *axis = &axes[node][3 * row];
                    const double along = dot3(corner, (double3)(axis[0], axis[1], axis[2]));
                    lower[node][row] = min(lower[node][row], along);
                    upper[node][row] = max(upper[node][row], along);
                }
                if (node == 0) {
                    break;
                }
            }
        }
    }
}
