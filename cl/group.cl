// The triangles of a leaf, WIDTH at a time: most are dismissed together, and the others tested one by one.

#include "lanes.cl"
#include "triangle.cl"

// A place on the device is WIDTH * group + lane.
INLINED corners_t corners_at(const global group_t *groups, const int place)
{
    const global group_t *group = groups + (uint)place / WIDTH;
    const uint lane = (uint)place % WIDTH;
    float3 corners[3];
    for (int i = 0; i < 3; i++) {
        corners[i] = (float3)(group->corners[i][0][lane], group->corners[i][1][lane], group->corners[i][2][lane]);
    }
    const corners_t result = {corners[0], corners[1], corners[2]};
    return result;
}

// What a ray needs for every group: where the coordinates are that are x, y and z for it, see permute_axes.
typedef struct {
    int row[3];
    float3 origin;
} turn_t;

INLINED turn_t make_turn(const path_t *path)
{
    turn_t turn;
    turn.row[0] = path->axis == 2 ? 0 : path->axis + 1;
    turn.row[1] = path->axis == 0 ? 2 : path->axis - 1;
    turn.row[2] = path->axis;
    turn.origin = permute_axes(path->origin, path->axis);
    return turn;
}

// Vertices seen along the ray, one per lane, as shear_vertex has them; z is not scaled yet.
typedef struct {
    lanes_t x;
    lanes_t y;
    lanes_t z;
} vertices_t;

INLINED vertices_t shear_lanes(
    const global group_t *group, const int corner, const path_t *path, const turn_t *turn)
{
    vertices_t vertices;
    vertices.z = load_lanes(group->corners[corner][turn->row[2]]) - turn->origin.z;
    vertices.x = load_lanes(group->corners[corner][turn->row[0]]) - turn->origin.x - path->shear.x * vertices.z;
    vertices.y = load_lanes(group->corners[corner][turn->row[1]]) - turn->origin.y - path->shear.y * vertices.z;
    return vertices;
}

INLINED float3 vertex_of_lane(const float vertices[3][WIDTH], const int lane, const path_t *path)
{
    return (float3)(vertices[0][lane], vertices[1][lane], path->shear.z * vertices[2][lane]);
}

INLINED void intersect_group(
    const global group_t *groups, const int group, const path_t *path, const turn_t *turn, search_t *search,
    const int query)
{
    const vertices_t a = shear_lanes(groups + group, 0, path, turn);
    const vertices_t b = shear_lanes(groups + group, 1, path, turn);
    const vertices_t c = shear_lanes(groups + group, 2, path, turn);

    // As in intersect_corners. The lanes of no triangle are NaN, and stay behind in both comparisons.
    const lanes_t edge_a = c.x * b.y - c.y * b.x;
    const lanes_t edge_b = a.x * c.y - a.y * c.x;
    const lanes_t edge_c = b.x * a.y - b.y * a.x;
    const lanes_t least = smaller_lanes(smaller_lanes(edge_a, edge_b), edge_c);
    const lanes_t most = larger_lanes(larger_lanes(edge_a, edge_b), edge_c);
    uint left = mask_bits((least >= 0.0f) | (most <= 0.0f));
    if (left == 0) {
        return;
    }

    union {
        vertices_t lanes[3];
        float vertices[3][3][WIDTH];
    } sheared = {{a, b, c}};
    do {
        const int lane = lowest_bit(left);
        left &= left - 1;
        cross_sheared(
            vertex_of_lane(sheared.vertices[0], lane, path), vertex_of_lane(sheared.vertices[1], lane, path),
            vertex_of_lane(sheared.vertices[2], lane, path), groups[group].prim_id[lane], WIDTH * group + lane, path,
            search, query);
    } while (left != 0);
}
