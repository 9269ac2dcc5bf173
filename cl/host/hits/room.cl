// Start points beside acute edges and corners, for clbvh/trace/hits/surface.py: where the tracer can tell them from the
// walls around.
//
// A start point is the centre of a ball that touches its triangle. Where no other triangle reaches into the ball, float
// cannot put the point behind any of them (docs/internals/offsets.md). Beside an acute edge the ball would reach
// through the next wall, so the point on the triangle is moved away from there until the ball fits. The walls are the
// triangles around the corners of the triangle that is left.

#include "hits/locations.cl"
#include "hits/surfaces.cl"
#include "math/doubles.cl"
#include "triangles/measure.cl"

// A wall reaches into a ball only if it does by more than this share of the radius: those in the plane of a triangle
// touch its ball, but for rounding, and one at half a degree would reach in by three times that, from behind the point.
#define SLACK 0x1p-16

// A surface is no wall where it is no steeper beside a triangle: a start point is on the right side of it in any case,
// and its distance has room for three quarters of the height.
#define LEAST_COSINE 0.75

// Walls that rise less above a triangle, in sines of the angle, are taken for parts of its plane.
#define LEAST_RISE 0x1p-14

// The most room that a wall takes beside it, in radii: an edge of half a degree has no more.
#define MOST_ROOM 512.0

// A point is moved along its triangle by at most this, in local units: enough in a corner of half a degree. The step
// grows by this factor.
#define MOST_MOVE 0x1p-8
#define STEP_GROWTH 1.5

// The margin of a triangle without walls.
#define NO_WALLS -1.0

// A mesh, in local coordinates, and the faces around its points, see `CornerFaces`.
typedef struct {
    const double (*vertices)[3];
    const int (*faces)[3];
    double3 origin;
    double scale;
    const int *points;
    const int *begins;
    const int *around;
} local_mesh_t;

// Walls around a triangle: corners, of which the first is shared.
typedef struct {
    double (*corners)[3][3];
    long count;
} walls_t;

static double3 load_local(const local_mesh_t *mesh, const int vertex)
{
    return (load_wide_row(mesh->vertices[vertex], 0) - mesh->origin) * mesh->scale;
}

static wide_corners_t load_face(const local_mesh_t *mesh, const int face)
{
    const int *ids = mesh->faces[face];
    const wide_corners_t corners = {load_local(mesh, ids[0]), load_local(mesh, ids[1]), load_local(mesh, ids[2])};
    return corners;
}

static double length_of(const double3 v)
{
    return sqrt(dot3(v, v));
}

static double3 unit_of(const double3 v)
{
    return v / length_of(v);
}

static bool is_same(const double3 a, const double3 b)
{
    return a.x == b.x && a.y == b.y && a.z == b.z;
}

static double3 load_wall(const walls_t *walls, const long wall, const int corner)
{
    return load_wide_row(walls->corners[wall][corner], 0);
}

// The lengths of the edges opposite to the corners.
static double3 lengths_of(const wide_corners_t *t)
{
    return (double3)(length_of(t->c - t->b), length_of(t->c - t->a), length_of(t->b - t->a));
}

static double least_height(const wide_corners_t *t)
{
    return length_of(cross3(t->b - t->a, t->c - t->a)) / largest_size(lengths_of(t));
}

// How far a point of a triangle is from its edges, in x, and from its corners, in y, in least heights of the triangle.
static double2 find_distances(const wide_corners_t *t, const double u, const double v)
{
    const double3 lengths = lengths_of(t);
    const double from_edge = min(min((1.0 - u - v) / lengths.x, u / lengths.y), v / lengths.z) * largest_size(lengths);
    const double3 place = t->a + u * (t->b - t->a) + v * (t->c - t->a);
    const double3 to_a = t->a - place, to_b = t->b - place, to_c = t->c - place;
    const double squared = min(min(dot3(to_a, to_a), dot3(to_b, to_b)), dot3(to_c, to_c));
    return (double2)(from_edge, sqrt(squared) / least_height(t));
}

// The cosine between the normal of a triangle and another one; NaN without an area.
static double cosine_of(const double3 a, const double3 b, const double3 c, const double3 normal)
{
    const double3 upright = cross3(b - a, c - a);
    return dot3(normal, upright) / length_of(upright);
}

// The least cosine between a face's normal and those of the faces around its corners.
static double find_least_cosine(const local_mesh_t *mesh, const int face, const double3 normal)
{
    double least = 1.0;
    for (int corner = 0; corner < 3; corner++) {
        const int point = mesh->points[mesh->faces[face][corner]];
        for (int slot = mesh->begins[point]; slot < mesh->begins[point + 1]; slot++) {
            const int *ids = mesh->faces[mesh->around[slot]];
            const double cosine =
                cosine_of(load_local(mesh, ids[0]), load_local(mesh, ids[1]), load_local(mesh, ids[2]), normal);
            least = min(least, cosine);
        }
    }
    return least;
}

// Writes the corners of the triangles around the corners of a face: first the corner that they share. Those that share
// two are there twice, or not at all if they are not steep.
static void find_walls(const local_mesh_t *mesh, const int face, const double3 normal, walls_t *walls)
{
    walls->count = 0;
    for (int corner = 0; corner < 3; corner++) {
        const int point = mesh->points[mesh->faces[face][corner]];
        for (int slot = mesh->begins[point]; slot < mesh->begins[point + 1]; slot++) {
            if (mesh->around[slot] == face) {
                continue;
            }
            const int *ids = mesh->faces[mesh->around[slot]];
            int first = 0, shared = 0;
            for (int own = 0; own < 3; own++) {
                const int own_point = mesh->points[ids[own]];
                first = own_point == point ? own : first;
                for (int of_face = 0; of_face < 3; of_face++) {
                    shared += mesh->points[mesh->faces[face][of_face]] == own_point;
                }
            }
            const double3 apex = load_local(mesh, ids[first]);
            const double3 one = load_local(mesh, ids[(first + 1) % 3]), two = load_local(mesh, ids[(first + 2) % 3]);
            if (shared < 2 || !(cosine_of(apex, one, two, normal) >= LEAST_COSINE)) {
                double (*wall)[3] = walls->corners[walls->count++];
                vstore3(apex, 0, wall[0]);
                vstore3(one, 0, wall[1]);
                vstore3(two, 0, wall[2]);
            }
        }
    }
}

static double room_beside(const double rise, const double cosine)
{
    return cosine < 1.0 ? min(rise / (1.0 - cosine), MOST_ROOM) : MOST_ROOM;
}

static double3 across_edge(const double3 direction, const double3 edge)
{
    return unit_of(direction + -dot3(direction, edge) * edge);
}

// The cosine of the least angle between a direction and those from one to another one.
static double least_angle(const double3 direction, const double3 left, const double3 right)
{
    const double3 normal = unit_of(cross3(left, right));
    if (dot3(cross3(left, direction), normal) >= 0.0 && dot3(cross3(direction, right), normal) >= 0.0) {
        const double height = dot3(direction, normal);
        return sqrt(max(1.0 - height * height, 0.0));
    }
    return max(dot3(direction, left), dot3(direction, right));
}

// Returns how close to an edge, in x, and to a corner, in y, of a triangle a ball of radius 1 may not fit, in least
// heights of the triangle: no point whose weights are all larger than the first one is so close to an edge.
//
// A wall and the triangle are two cones from a common corner. With a direction d of the one and e of the other, of
// length 1, the ball that touches the triangle at `r e` reaches the wall where `r < d.normal / (1 - d.e)`.
static double2 find_margins(const wide_corners_t *t, const double3 normal, const walls_t *walls)
{
    double of_edges = 0.0, of_corners = 0.0;
    for (long wall = 0; wall < walls->count; wall++) {
        const double3 apex = load_wall(walls, wall, 0);
        const double3 one = load_wall(walls, wall, 1), two = load_wall(walls, wall, 2);
        const int corner = is_same(apex, t->a) ? 0 : is_same(apex, t->b) ? 1 : 2;
        double3 d = one - apex, other_d = two - apex;
        if (!(max(dot3(d, normal), dot3(other_d, normal)) > 0.0)) {
            continue;
        }
        d = unit_of(d);
        other_d = unit_of(other_d);
        double rise = max(dot3(d, normal), dot3(other_d, normal));
        if (!(rise > LEAST_RISE)) {
            continue;
        }
        const double3 left = corner == 0 ? t->b : corner == 1 ? t->c : t->a;
        const double3 right = corner == 0 ? t->c : corner == 1 ? t->a : t->b;
        double3 e = unit_of(left - apex), other_e = unit_of(right - apex);
        const bool has_left = is_same(left, one) || is_same(left, two);
        const bool has_right = is_same(right, one) || is_same(right, two);
        if (has_left || has_right) {
            // At a common edge, the directions that matter are those at right angles to it.
            if (is_same(one, left) || is_same(one, right)) {
                d = other_d;
            }
            if (has_right) {
                const double3 swapped = e;
                e = other_e;
                other_e = swapped;
            }
            d = across_edge(d, e);
            other_e = across_edge(other_e, e);
            of_edges = max(of_edges, room_beside(dot3(d, normal), dot3(d, other_e)));
        } else {
            const double of_triangle = max(least_angle(e, d, other_d), least_angle(other_e, d, other_d));
            const double cosine = max(max(least_angle(d, e, other_e), least_angle(other_d, e, other_e)), of_triangle);
            // Directions between two may rise more than both.
            rise /= sqrt(max(0.5 + 0.5 * dot3(d, other_d), 0.0));
            of_corners = max(of_corners, room_beside(min(rise, 1.0), cosine));
        }
    }
    const double unit = least_height(t);
    // Written so that NaN has no walls.
    return (double2)(of_edges > 0.0 ? of_edges / unit : NO_WALLS, of_corners > 0.0 ? of_corners / unit : NO_WALLS);
}

// Whether no wall reaches into a ball.
static bool fits(const walls_t *walls, const double3 centre, const double radius)
{
    const double reach = radius * (1.0 - SLACK), limit = reach * reach;
    const double3 ball[3] = {centre, centre, centre};
    bool is_open;
    for (long wall = 0; wall < walls->count; wall++) {
        const double3 corners[3] = {load_wall(walls, wall, 0), load_wall(walls, wall, 1), load_wall(walls, wall, 2)};
        if (measure_triangles(ball, corners, limit, &is_open) < limit) {
            return false;
        }
    }
    return true;
}

// The coordinates of the nearest point of a triangle at which a ball fits; those given if there is none. The point is
// moved at right angles away from each edge, and to the centroid, by longer and longer steps.
static double2 find_place(
    const wide_corners_t *t, const double3 normal, const walls_t *walls, const double radius, const double u,
    const double v)
{
    const double3 ab = t->b - t->a, ac = t->c - t->a;
    const double3 place = t->a + u * ab + v * ac;
    if (fits(walls, place + radius * normal, radius)) {
        return (double2)(u, v);
    }
    const double doubled_area = length_of(cross3(ab, ac));
    const double3 upright = unit_of(cross3(ab, ac));
    const double3 centroid = t->a + 1.0 / 3.0 * ab + 1.0 / 3.0 * ac;
    const double3 ways[4] = {
        cross3(upright, t->c - t->b), cross3(upright, t->a - t->c), cross3(upright, ab), centroid - place};
    for (double step = radius; step <= MOST_MOVE; step *= STEP_GROWTH) {
        for (int toward = 0; toward < 4; toward++) {
            const double3 way = unit_of(ways[toward]);
            const double moved_u = u + step * dot3(ways[1], way) / doubled_area;
            const double moved_v = v + step * dot3(ways[2], way) / doubled_area;
            if (min(min(moved_u, moved_v), 1.0 - moved_u - moved_v) > 0.0 &&
                fits(walls, place + step * way + radius * normal, radius)) {
                return (double2)(moved_u, moved_v);
            }
        }
    }
    return (double2)(u, v);
}

// Stores the margins of both sides of a face, of which the first one of each tells other threads that all are there.
static void store_margins(float own[4], const double2 outer, const double2 inner)
{
    own[1] = (float)outer.y;
    own[3] = (float)inner.y;
    __atomic_thread_fence(__ATOMIC_RELEASE);
    own[0] = (float)outer.x;
    own[2] = (float)inner.x;
}

// Finds the margins of faces of a mesh.
//
// vertices[][3], faces[][3], origin[3], scale, points[], begins[], around[]    of the mesh, and its `CornerFaces`
// margins[face_count][4]    written, see `SurfaceArrays`
// chosen[chosen_count]      the faces
// wall_corners[][3][3]      written: has room for all faces around the corners of one of them
loop void find_face_margins(
    const double *vertices, const long face_count, const int faces[face_count][3], const double origin[3],
    const double scale, const int *points, const int *begins, const int *around, float margins[face_count][4],
    const long chosen_count, const int chosen[chosen_count], double *wall_corners)
{
    const local_mesh_t mesh = {
        (const double (*)[3])vertices, faces, load_wide_row(origin, 0), scale, points, begins, around};
    walls_t walls = {(double (*)[3][3])wall_corners, 0};
    for (long item = 0; item < chosen_count; item++) {
        const int face = chosen[item];
        const wide_corners_t t = load_face(&mesh, face);
        const double3 outer = normal_of(&t, 1.0);
        double2 of_outer = (double2)(NO_WALLS), of_inner = of_outer;
        if (!(find_least_cosine(&mesh, face, outer) >= LEAST_COSINE)) {
            find_walls(&mesh, face, outer, &walls);
            of_outer = find_margins(&t, outer, &walls);
            of_inner = find_margins(&t, -outer, &walls);
        }
        store_margins(margins[face], of_outer, of_inner);
    }
}

// Moves points on triangles of a mesh away from walls that are too close.
//
// vertices[][3] to margins[face_count][4]    see `find_face_margins`
// rows[row_count]     the points that are looked at, by their indices
// wall_corners[][3][3]    written: has room for all faces around one of these points
// us[count], vs[count]    written
// heights[count]      written: of the start points above them, in local units; 0 where no wall can be too close
loop void make_room(
    const double *vertices, const long face_count, const int faces[face_count][3], const double origin[3],
    const double scale, const int *points, const int *begins, const int *around, const float margins[face_count][4],
    const long row_count, const long rows[row_count], double *wall_corners, const long count,
    const int prim_ids[count], double us[count], double vs[count], const bool is_front[count], double heights[count])
{
    const local_mesh_t mesh = {
        (const double (*)[3])vertices, faces, load_wide_row(origin, 0), scale, points, begins, around};
    walls_t walls = {(double (*)[3][3])wall_corners, 0};
    for (long item = 0; item < row_count; item++) {
        const long row = rows[item];
        const int face = prim_ids[row];
        const float *own = margins[face] + (is_front[row] ? 0 : 2);
        const wide_corners_t t = load_face(&mesh, face);
        const double2 distances = find_distances(&t, us[row], vs[row]);
        if (!(distances.x < own[0] * heights[row] || distances.y < own[1] * heights[row])) {
            heights[row] = 0.0;
            continue;
        }
        const double3 outer = normal_of(&t, 1.0);
        find_walls(&mesh, face, outer, &walls);
        const double2 moved =
            find_place(&t, is_front[row] ? outer : -outer, &walls, heights[row], us[row], vs[row]);
        us[row] = moved.x;
        vs[row] = moved.y;
    }
}
