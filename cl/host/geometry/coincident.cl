// Faces that coincide, by clbvh/geometry/coincident.py.

// Corners in the same cell of this size, in local units, are as near as float32 tells apart at the rim of the mesh.
#define CELLS 0x1p24f

// Of each axis: odd numbers without a pattern.
#define FACTORS (const ulong[]){0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9}

// Keys of points are mixed before those of a face's corners are added: on a grid, many sums of plain ones are equal. As
// in the generator SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
static ulong mixed(ulong key)
{
    key = (key ^ key >> 30) * 0xBF58476D1CE4E5B9;
    return key ^ key >> 30;
}

// Writes a key of the cell of each vertex, and the sum of the keys at the corners of each face.
loop void find_keys(
    const long vertex_count, const float vertices[vertex_count][3],
    const long face_count, const int faces[face_count][3], ulong keys[vertex_count], ulong face_keys[face_count])
{
    for (long vertex = 0; vertex < vertex_count; vertex++) {
        ulong key = 0;
        for (int axis = 0; axis < 3; axis++) {
            key += (ulong)(long)rint(vertices[vertex][axis] * CELLS) * FACTORS[axis];
        }
        keys[vertex] = mixed(key);
    }
    for (long face = 0; face < face_count; face++) {
        face_keys[face] = keys[faces[face][0]] + keys[faces[face][1]] + keys[faces[face][2]];
    }
}

// The least face that a face hangs together with so far, with a shorter way to it for the next one.
static long least_of_surface(long *surfaces, long face)
{
    while (surfaces[face] != face) {
        surfaces[face] = surfaces[surfaces[face]];
        face = surfaces[face];
    }
    return face;
}

// Writes the least face of all faces that hang together by edges (union-find with path halving).
//
// users               written: a face at each edge; -1 before
loop void join_faces(
    const long face_count, const long edge_ids[face_count][3], const long edge_count, long users[edge_count],
    long surfaces[face_count])
{
    for (long face = 0; face < face_count; face++) {
        surfaces[face] = face;
        for (int side = 0; side < 3; side++) {
            const long edge = edge_ids[face][side];
            if (users[edge] < 0) {
                users[edge] = face;
                continue;
            }
            const long other = least_of_surface(surfaces, users[edge]);
            const long own = least_of_surface(surfaces, face);
            surfaces[max(other, own)] = min(other, own);
        }
    }
    for (long face = 0; face < face_count; face++) {
        surfaces[face] = surfaces[surfaces[face]];
    }
}
