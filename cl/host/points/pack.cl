// Points, packed for a device as pairs of float32, by clbvh/trace/points/pack.py and ambient_occlusion.py.
//
// Parameters that the loops share:
//
// points[][3]         floats or doubles, by is_double; the file's coordinates
// box[7]              of the world, see cl/rays/pack.cl

#include "structs.cl"
#include "math/bits.cl"
#include "points/pack.cl"
#include "rays/arrays.cl"

// Along each axis of a cube around the box: 8 bits of a key.
#define CELLS 256

// The point of a half-space that is farther away than this, in local units, is moved to that distance: what is seen
// from there is too small for a ray to meet it, and float32 holds the coordinates.
#define FARTHEST 0x1p24

INLINED double3 load_point(const void *points, const long point, const int is_double)
{
    const long step = is_double ? sizeof(double) : sizeof(float);
    return load_vector((const char *)points + 3 * point * step, step, is_double);
}

// Returns the number of the first point whose local coordinates are not finite, or -1.
loop long find_bad(const void *points, const int is_double, const long count, const double box[7])
{
    const tree_box_t tree_box = load_tree_box(box);
    for (long point = 0; point < count; point++) {
        if (!is_finite_point(localize_point(load_point(points, point, is_double), &tree_box))) {
            return point;
        }
    }
    return -1;
}

// Writes the keys by which points are ordered: Morton codes of cells of a cube. Points outside of it count as on its
// border.
//
// half_size           of the cube
// cells_per_unit      CELLS over its size
loop void write_keys(
    const void *points, const int is_double, const double centre[3], const double half_size,
    const double cells_per_unit, const long count, int keys[count])
{
    for (long point = 0; point < count; point++) {
        const double3 place =
            (load_point(points, point, is_double) - vload3(0, centre) + half_size) * cells_per_unit;
        int key = 0;
        for (int axis = 0; axis < 3; axis++) {
            // Written so that NaN is in the first cell.
            const int cell = !(place[axis] > 0.0) ? 0 : place[axis] >= CELLS ? CELLS - 1 : (int)place[axis];
            key |= (int)spread_bits(cell) << axis;
        }
        keys[point] = key;
    }
}

// Writes points, by their numbers.
//
// masks, limits       of each point if each_mask or each_limit is true, or one for all
loop void pack_points(
    const void *points, const int is_double, const uint *masks, const bool each_mask, const double *limits,
    const bool each_limit, const double box[7], const long count, const int order[count], packed_point_t packed[count])
{
    const tree_box_t tree_box = load_tree_box(box);
    for (long slot = 0; slot < count; slot++) {
        const long point = order[slot];
        const double3 local_point = localize_point(load_point(points, point, is_double), &tree_box);
        store_vector(come_near(local_point, &tree_box), packed[slot].position, packed[slot].position_low);
        packed[slot].mask = masks[each_mask ? point : 0];
        packed[slot].limit = localize_limit(limits[each_limit ? point : 0], &tree_box);
    }
}

// Writes half-spaces over points, by their numbers.
//
// normals, max_distances      doubles, as the points
// each_row                    bit 0: there is a point for each of them, bit 1: a normal, bit 2: a distance, bit 3: a
//                             mask; else one for all
// rounding, offset            see `HemisphereRows`
// surface_rounding            of a lone shape's surface, relative
// pair_rounding               of pairs of float32, absolute
loop void pack_hemispheres(
    const double *points, const double *normals, const double *max_distances, const uint *masks, const int each_row,
    const double rounding, const double offset, const long first_number, const double box[7],
    const double surface_rounding, const double pair_rounding, const long count, const int order[count],
    hemisphere_t packed[count])
{
    const tree_box_t tree_box = load_tree_box(box);
    for (long slot = 0; slot < count; slot++) {
        const long number = order[slot];
        const double3 given = load_point(normals, each_row & 2 ? number : 0, 1);
        const double3 scaled = given / largest_size(given);
        const double3 normal = scaled / sqrt(dot3(scaled, scaled));
        const double3 point = load_point(points, each_row & 1 ? number : 0, 1);
        const double3 local_point = localize_point(point, &tree_box);

        const double reach = largest_size(local_point);
        const double share = reach > FARTHEST ? FARTHEST / reach : 1.0;
        const double3 sizes = fabs(normal);
        const double breadth = sizes.x + sizes.y + sizes.z;
        const double coarseness = dot3(sizes, fabs(point));
        const double lift = (surface_rounding * (1.0 + least_of(reach, FARTHEST)) + pair_rounding) * breadth
            + (rounding * coarseness + offset) * tree_box.scale;

        hemisphere_t *item = packed + slot;
        store_vector(local_point * share + lift * normal, item->position, item->position_low);
        vstore3(__builtin_convertvector(normal, float3), 0, item->normal);
        item->t_max = (float)(max_distances[each_row & 4 ? number : 0] * tree_box.scale);
        item->mask = masks[each_row & 8 ? number : 0];
        item->number = (uint)(first_number + number);
    }
}
