// Normals of faces and smooth normals at their corners, by clbvh/geometry/topology.py and smooth_normals.py.

#include "math/angles.cl"
#include "math/doubles.cl"

// A sum of unit vectors is no direction if it is shorter than this share of their weights.
#define LEAST_SHARE 1e-6

// Corners at one point with which each of them is compared. Where there are more, these are spread evenly over all, in
// the order of the faces: the point of a cone of a million faces would take hours.
#define MOST_COMPARED 256

// Writes the unit normals of some faces, zero without an area, and the angles at their corners in radians.
//
// scale               a power of two that brings the mesh to a size of about 1
loop void measure_faces(
    const long vertex_count, const double vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], const double scale, const long begin, const long end,
    double normals[face_count][3], double angles[face_count][3])
{
    for (long face = begin; face < end; face++) {
        for (int corner = 0; corner < 3; corner++) {
            const double3 own = vload3(0, vertices[faces[face][corner]]);
            const double3 u = (vload3(0, vertices[faces[face][(corner + 1) % 3]]) - own) * scale;
            const double3 v = (vload3(0, vertices[faces[face][(corner + 2) % 3]]) - own) * scale;
            const double3 across = cross3(u, v);
            // Divided by the largest component first: the squares of a small triangle's normal could underflow.
            const double largest = largest_size(across);
            const double3 normal = largest == 0.0 ? across : across / largest;
            const double length = sqrt(dot3(normal, normal));
            angles[face][corner] = largest == 0.0 ? 0.0 : angle_of(length * largest, dot3(u, v));
            if (corner == 0) {
                vstore3(largest == 0.0 ? (double3)(0.0) : normal / length, 0, normals[face]);
            }
        }
    }
}

// The mesh around its points, see `CornerFaces`, and what is written: normals at the corners.
typedef struct {
    const int (*faces)[3];
    const double (*normals)[3];
    const double (*angles)[3];
    const long *point_ids;
    float (*smooth)[3][3];
} corners_t;

static void store_normal(const corners_t *mesh, const long face, const long point, const double3 normal)
{
    for (int corner = 0; corner < 3; corner++) {
        if (mesh->point_ids[mesh->faces[face][corner]] == point) {
            vstore3(__builtin_convertvector(normal, float3), 0, mesh->smooth[face][corner]);
        }
    }
}

// The angle of a face at a point. One with two corners there has no area, and so no angle.
static double angle_at(const corners_t *mesh, const long face, const long point)
{
    for (int corner = 0; corner < 3; corner++) {
        if (mesh->point_ids[mesh->faces[face][corner]] == point) {
            return mesh->angles[face][corner];
        }
    }
    return 0.0;
}

// Writes the smooth normals at the corners in some points.
//
// point_ids, begin, around    see `CornerFaces`
// least_cosine        of the normals of two faces that are smoothed over
// half_cosine         of half that angle
loop void smooth_corners(
    const long face_count, const int faces[face_count][3], const double normals[face_count][3],
    const double angles[face_count][3], const long vertex_count, const long point_ids[vertex_count],
    const long point_count, const long begin[point_count], const long around[3 * face_count],
    const double least_cosine, const double half_cosine, const long first_point, const long end_point,
    float smooth[face_count][3][3])
{
    const corners_t mesh = {faces, normals, angles, point_ids, smooth};
    for (long point = first_point; point < end_point; point++) {
        const long first = begin[point];
        const long end = begin[point + 1];
        // Where all normals are within half the angle of one, no two differ by more: nearly everywhere, nearly always.
        double3 sum = (double3)(0.0);
        for (long slot = first; slot < end; slot++) {
            sum += angle_at(&mesh, around[slot], point) * vload3(0, normals[around[slot]]);
        }
        const double length = sqrt(dot3(sum, sum));
        bool is_smooth = length > 0.0;
        for (long slot = first; slot < end && is_smooth; slot++) {
            is_smooth = dot3(sum, vload3(0, normals[around[slot]])) > half_cosine * length;
        }
        if (is_smooth) {
            for (long slot = first; slot < end; slot++) {
                store_normal(&mesh, around[slot], point, sum / length);
            }
            continue;
        }
        const long step = 1 + (end - first - 1) / MOST_COMPARED;
        for (long slot = first; slot < end; slot++) {
            const long face = around[slot];
            const double3 own = vload3(0, normals[face]);
            const bool has_area = own.x != 0.0 || own.y != 0.0 || own.z != 0.0;
            const double least = has_area ? least_cosine : -2.0;
            double3 near = (double3)(0.0);
            double weight = 0.0;
            for (long other_slot = first + (slot - first) % step; other_slot < end; other_slot += step) {
                const long other = around[other_slot];
                const double3 normal = vload3(0, normals[other]);
                if (other == face || dot3(own, normal) > least) {
                    const double angle = angle_at(&mesh, other, point);
                    near += angle * normal;
                    weight += angle;
                }
            }
            const double near_length = sqrt(dot3(near, near));
            if (near_length > LEAST_SHARE * weight) {
                near /= near_length;
            } else {
                // The normals cancel each other: the corner has that of its own face.
                near = has_area ? own : (double3)(0.0, 0.0, 1.0);
            }
            store_normal(&mesh, face, point, near);
        }
    }
}

// Writes the faces of the corners by their points, and where each point's begin.
//
// begins              0 before
loop void sort_corners(
    const long vertex_count, const int points[vertex_count], const long face_count, const int faces[face_count][3],
    const long begin_count, int begins[begin_count], int corner_faces[3 * face_count])
{
    for (long face = 0; face < face_count; face++) {
        for (int corner = 0; corner < 3; corner++) {
            begins[points[faces[face][corner]]]++;
        }
    }
    for (long point = 1; point < begin_count; point++) {
        begins[point] += begins[point - 1];
    }
    for (long face = face_count - 1; face >= 0; face--) {
        for (int corner = 0; corner < 3; corner++) {
            corner_faces[--begins[points[faces[face][corner]]]] = (int)face;
        }
    }
}
