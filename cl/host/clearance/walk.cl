// Two trees at once: the nearest triangles of pairs of instances, by clbvh/trace/clearance/walk.py.

#include "structs.cl"
#include "clearance/boxes.cl"
#include "hits/surfaces.cl"
#include "triangles/measure.cl"

// The size of the stack of a pair that is not begun.
#define NOT_BEGUN -1

// Writes the corners of a triangle of an instance in the world, times `unit`.
static void place_triangle(
    const surfaces_t *surfaces, const long instance, const int prim, const double unit, double3 triangle[3])
{
    const wide_corners_t corners = load_wide_corners(surfaces, surfaces->geometry_id[instance], prim);
    const double3 offset = load_wide_row(surfaces->offset, instance);
    triangle[0] = (multiply(surfaces->linear, instance, corners.a) + offset) * unit;
    triangle[1] = (multiply(surfaces->linear, instance, corners.b) + offset) * unit;
    triangle[2] = (multiply(surfaces->linear, instance, corners.c) + offset) * unit;
}

// Writes the corners of two triangles of two instances in the world.
loop void place_pair(
    const ulong addresses[20], const long instances[2], const int prims[2], double corners[6][3])
{
    const surfaces_t *surfaces = (const surfaces_t *)addresses;
    for (int which = 0; which < 2; which++) {
        double3 triangle[3];
        place_triangle(surfaces, instances[which], prims[which], 1.0, triangle);
        for (int corner = 0; corner < 3; corner++) {
            vstore3(triangle[corner], 3 * which + corner, corners[0]);
        }
    }
}

// Writes the pairs of boxes that overlap, as far as there is room; returns their number.
//
// order               of the boxes, by the lower ends of their first sides
loop long sweep(
    const long count, const double lower[count][3], const double upper[count][3], const long order[count],
    const long room, long pairs[room][2])
{
    long pair_count = 0;
    for (long index = 0; index < count; index++) {
        const long one = order[index];
        for (long later = index + 1; later < count; later++) {
            const long other = order[later];
            if (lower[other][0] > upper[one][0]) {
                break;
            }
            if (lower[other][1] <= upper[one][1] && lower[one][1] <= upper[other][1] &&
                lower[other][2] <= upper[one][2] && lower[one][2] <= upper[other][2]) {
                if (pair_count < room) {
                    pairs[pair_count][0] = min(one, other);
                    pairs[pair_count][1] = max(one, other);
                }
                pair_count++;
            }
        }
    }
    return pair_count;
}

// Where a search may go on, see `_STATE` of walk.py.
//
// size                the entries on the stack
// tested              the tests done of the leaves on top
// prim_ids            the triangles that float64 cannot decide
typedef struct {
    long pair;
    long size;
    long tested;
    long prim_ids[2];
} state_t;

// Two nodes, and at most the squared distance of what is in them.
typedef struct {
    long nodes[2];
    double bound;
} entry_t;

// Pairs of instances, their trees, see `JoinedTrees`, and what is found of them.
typedef struct {
    const surfaces_t *surfaces;
    const int (*links)[2];
    const surface_box_t *boxes;
    const int *tree_prim_ids;
    const long *first_node;
    const long *first_prim;
    const long (*pairs)[2];
    double unit;
    state_t *state;
    entry_t *stack;
    double *squared;
    int (*prim_ids)[2];
} search_t;

// The poses of two instances.
static poses_t take_poses(const search_t *search, const long instances[2])
{
    const surfaces_t *surfaces = search->surfaces;
    poses_t poses = {.way = (double3)(0.0), .room = 0.0};
    for (int which = 0; which < 2; which++) {
        const long instance = instances[which];
        const int geometry = surfaces->geometry_id[instance];
        const double3 origin = load_wide_row(surfaces->origin, geometry);
        const double factor = search->unit / surfaces->scale[geometry];
        pose_t *pose = &poses.of[which];
        double reach = 0.0;
        double largest = 0.0;
        for (int row = 0; row < 3; row++) {
            const double3 linear = load_wide_row(surfaces->linear, 3 * instance + row);
            double centre = load_wide_row(surfaces->offset, instance)[row];
            double size = fabs(centre);
            for (int column = 0; column < 3; column++) {
                const double along = linear[column] * origin[column];
                centre += along;
                size += fabs(along);
                pose->rows[row][column] = linear[column] * factor;
                largest = most_of(largest, fabs(pose->rows[row][column]));
            }
            poses.way[row] += which == 1 ? centre * search->unit : -centre * search->unit;
            reach = most_of(reach, size * search->unit);
        }
        poses.room += ROOM_OF_BOXES * largest + ROOM_OF_PLACES * reach;

        const double3 x = (double3)(pose->rows[0].x, pose->rows[1].x, pose->rows[2].x);
        const double3 y = (double3)(pose->rows[0].y, pose->rows[1].y, pose->rows[2].y);
        const double3 z = (double3)(pose->rows[0].z, pose->rows[1].z, pose->rows[2].z);
        const double squared = dot3(x, x);
        const double skew = largest_size((double3)(dot3(x, y), dot3(y, z), dot3(z, x)));
        const double off = most_of(most_of(skew, fabs(dot3(y, y) - squared)), fabs(dot3(z, z) - squared));
        pose->stretch = sqrt(squared) * (off <= SIMILAR * squared ? 1.0 : -1.0);
    }
    return poses;
}

// Tests the triangles of two leaves; returns false where a pair of them is to be decided by others.
static bool test_leaves(const search_t *search, const long instances[2], const long nodes[2])
{
    state_t *state = search->state;
    const long pair = state->pair;
    const long tested = state->tested;
    const int *prim_ids[2];
    int counts[2];
    for (int which = 0; which < 2; which++) {
        const int geometry = search->surfaces->geometry_id[instances[which]];
        const int *link = search->links[nodes[which]];
        prim_ids[which] = &search->tree_prim_ids[search->first_prim[geometry] + link[0]];
        counts[which] = link[1];
    }
    long number = 0;
    state->tested = 0;
    for (int slot_a = 0; slot_a < counts[0]; slot_a++) {
        const int prim_a = prim_ids[0][slot_a];
        if (prim_a == NO_PRIM) {
            number += counts[1];
            continue;
        }
        double3 one[3];
        place_triangle(search->surfaces, instances[0], prim_a, search->unit, one);
        for (int slot_b = 0; slot_b < counts[1]; slot_b++) {
            number++;
            const int prim_b = prim_ids[1][slot_b];
            if (number <= tested || prim_b == NO_PRIM) {
                continue;
            }
            double3 other[3];
            place_triangle(search->surfaces, instances[1], prim_b, search->unit, other);
            bool is_open;
            const double squared = measure_triangles(one, other, search->squared[pair], &is_open);
            if (is_open) {
                *state = (state_t){pair, state->size, number, {prim_a, prim_b}};
                return false;
            }
            if (squared < search->squared[pair]) {
                search->squared[pair] = squared;
                search->prim_ids[pair][0] = prim_a;
                search->prim_ids[pair][1] = prim_b;
            }
        }
    }
    return true;
}

// Walks the trees of a pair of instances, the nearer boxes first; returns as `test_leaves`.
static bool walk_pair(const search_t *search, const long instances[2], const poses_t *poses)
{
    state_t *state = search->state;
    const surface_box_t *boxes = search->boxes;
    while (state->size > 0) {
        state->size--;
        const entry_t entry = search->stack[state->size];
        if (entry.bound >= search->squared[state->pair]) {
            state->tested = 0;  // also of leaves whose tests were not done
            continue;
        }
        const long a = entry.nodes[0];
        const long b = entry.nodes[1];
        const bool is_leaf_a = search->links[a][1] > 0;
        const bool is_leaf_b = search->links[b][1] > 0;
        if (is_leaf_a && is_leaf_b) {
            if (!test_leaves(search, instances, entry.nodes)) {
                state->size++;
                return false;
            }
            continue;
        }
        // The larger one is opened.
        const bool is_b = is_leaf_a || (!is_leaf_b && !(size_of_box(&boxes[a]) * fabs(poses->of[0].stretch) >
                                                        size_of_box(&boxes[b]) * fabs(poses->of[1].stretch)));
        const long first = search->first_node[search->surfaces->geometry_id[instances[is_b]]];
        entry_t left = entry;
        left.nodes[is_b] = first + search->links[entry.nodes[is_b]][0];
        entry_t right = left;
        right.nodes[is_b]++;
        const double2 of_left = bound_distance(&boxes[left.nodes[0]], &boxes[left.nodes[1]], poses);
        const double2 of_right = bound_distance(&boxes[right.nodes[0]], &boxes[right.nodes[1]], poses);
        left.bound = of_left.x;
        right.bound = of_right.x;
        // The nearer one on top.
        const bool is_left_nearer = of_left.y < of_right.y;
        search->stack[state->size++] = is_left_nearer ? right : left;
        search->stack[state->size++] = is_left_nearer ? left : right;
    }
    return true;
}

// Goes on with a search; returns false where a pair of triangles is to be decided by others.
//
// gaps                squared distances of the instances' boxes
// is_chained          whether each pair must be nearer than all before it
// squared             the limits before, and what is found
loop bool walk(
    const ulong addresses[20], const long node_count, const int links[node_count][2],
    const float boxes[node_count][15], const int *tree_prim_ids, const long geometry_count,
    const long first_node[geometry_count], const long first_prim[geometry_count], const long pair_count,
    const long pairs[pair_count][2], const double gaps[pair_count], const double unit, const bool is_chained,
    long state_words[5], long *stack, double squared[pair_count], int prim_ids[pair_count][2])
{
    state_t *state = (state_t *)state_words;
    const surfaces_t *surfaces = (const surfaces_t *)addresses;
    const search_t search = {
        surfaces, links, (const surface_box_t *)boxes, tree_prim_ids, first_node, first_prim, pairs, unit, state,
        (entry_t *)stack, squared, prim_ids,
    };
    for (; state->pair < pair_count; state->pair++, state->size = NOT_BEGUN) {
        const long pair = state->pair;
        if (state->size == NOT_BEGUN) {
            state->size = 0;
            if (is_chained && pair > 0) {
                squared[pair] = squared[pair - 1];
            }
            if (gaps[pair] < squared[pair]) {
                const long node_a = first_node[surfaces->geometry_id[pairs[pair][0]]];
                const long node_b = first_node[surfaces->geometry_id[pairs[pair][1]]];
                search.stack[0] = (entry_t){{node_a, node_b}, gaps[pair]};
                state->size = 1;
            }
        }
        if (state->size > 0) {
            const poses_t poses = take_poses(&search, pairs[pair]);
            if (!walk_pair(&search, pairs[pair], &poses)) {
                return false;
            }
        }
    }
    return true;
}
