// Sizes, areas and shards of faces, for clbvh/geometry.

#include "triangles/collinear.cl"

// The corner of a face.
#define CORNER(vertices, ids, corner) \
    (double3)(vertices[ids[corner]][0], vertices[ids[corner]][1], vertices[ids[corner]][2])

// Raises the size of each vertex to the longest sides of the boxes around its faces.
loop void find_sizes(
    const long vertex_count, const double vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], double sizes[vertex_count])
{
    for (long face = 0; face < face_count; face++) {
        double size = 0.0;
        for (int axis = 0; axis < 3; axis++) {
            const double x = vertices[faces[face][0]][axis];
            const double y = vertices[faces[face][1]][axis];
            const double z = vertices[faces[face][2]][axis];
            size = max(size, max(max(x, y), z) - min(min(x, y), z));
        }
        for (int corner = 0; corner < 3; corner++) {
            sizes[faces[face][corner]] = max(sizes[faces[face][corner]], size);
        }
    }
}

// Writes whether the corners of each face lie on one line or in one point.
loop void find_degenerate(
    const long vertex_count, const float vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], bool degenerate[face_count])
{
    for (long face = 0; face < face_count; face++) {
        const int *ids = faces[face];
        degenerate[face] = is_collinear(CORNER(vertices, ids, 0), CORNER(vertices, ids, 1), CORNER(vertices, ids, 2));
    }
}

// The same of vertices in float64.
loop void find_degenerate_of_doubles(
    const long vertex_count, const double vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], bool degenerate[face_count])
{
    for (long face = 0; face < face_count; face++) {
        const int *ids = faces[face];
        degenerate[face] = is_collinear(CORNER(vertices, ids, 0), CORNER(vertices, ids, 1), CORNER(vertices, ids, 2));
    }
}

// Writes the shard of each face; those of a cell that has several are dealt in the order of the faces.
//
// counts, firsts, shares  of each cell: its faces, its first shard, and the number of its shards
// ranks                   raised: the faces of each cell that have a shard
loop void find_shards(
    const long face_count, const int cells[face_count], const long cell_count, const long counts[cell_count],
    const int firsts[cell_count], const int shares[cell_count], long ranks[cell_count], int numbers[face_count])
{
    for (long face = 0; face < face_count; face++) {
        const int cell = cells[face];
        numbers[face] = (int)(firsts[cell] + ranks[cell] * shares[cell] / counts[cell]);
        ranks[cell]++;
    }
}
