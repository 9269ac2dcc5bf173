// The instances of a scene: inverses of their matrices, boxes, and their records on the device. By surface_arrays.py
// and top_tree.py of clbvh/trace/world; for the arrays see `SurfaceArrays` there.

#include "structs.cl"
#include "math/doubles.cl"

// An instance's box grows by this share of its own size, times the condition of its matrix, up to its whole size: more
// than a ray loses by entering it in float32. A ray begins up to 36 radii away when it is rounded, and each of its
// components is a sum of three products.
#define OWN_GROWTH 0x1p-15

// Bounds that are computed in float64 and kept in float32 have this much room.
#define ROOM (1.0 + 0x1p-20)

// Exponents that `times_power_of_two` takes. What they leave out is zero or infinite with and without the limit.
#define LEAST_EXPONENT -1991
#define MOST_EXPONENT 2046

// Writes the inverses of matrices, and whether their determinants are below zero.
//
// Rows and columns are scaled by powers of two first, which rounds nothing: then the products of a matrix that
// stretches its axes by factors far apart neither underflow nor drown each other. One step of Newton's method removes
// most of what the cofactors lose by cancellation. `numpy.linalg.inv` takes eight times as long.
loop void invert(
    const long count, const double matrices[count][3][3], double inverses[count][3][3], bool is_negative[count])
{
    for (long index = 0; index < count; index++) {
        double3 matrix[3];
        int rows[3];
        int columns[3];
        for (int row = 0; row < 3; row++) {
            const double3 given = vload3(row, matrices[index][0]);
            rows[row] = exponent_of(largest_size(given));
            matrix[row] = times_power_of_two3(given, -rows[row]);
        }
        for (int column = 0; column < 3; column++) {
            columns[column] =
                exponent_of(largest_size((double3)(matrix[0][column], matrix[1][column], matrix[2][column])));
            for (int row = 0; row < 3; row++) {
                matrix[row][column] = times_power_of_two(matrix[row][column], -columns[column]);
            }
        }
        double3 cofactors[3];
        for (int row = 0; row < 3; row++) {
            cofactors[row] = cross3(matrix[(row + 1) % 3], matrix[(row + 2) % 3]);
        }
        const double determinant = dot3(matrix[0], cofactors[0]);
        is_negative[index] = determinant < 0.0;
        for (int row = 0; row < 3; row++) {
            cofactors[row] /= determinant;
        }
        for (int column = 0; column < 3; column++) {
            double3 refined = cofactors[column];
            for (int row = 0; row < 3; row++) {
                // Of the identity less the product of the matrix and that of its inverse.
                const double3 products = matrix[row] * cofactors[column];
                const double error = (row == column ? 1.0 : 0.0) - products.x - products.y - products.z;
                refined += error * cofactors[row];
            }
            for (int row = 0; row < 3; row++) {
                const int exponent = clamp(-columns[row] - rows[column], LEAST_EXPONENT, MOST_EXPONENT);
                inverses[index][row][column] = times_power_of_two(refined[row], exponent);
            }
        }
    }
}

// By how much rounding can grow on the way into an instance and back; 1 for a map along the axes.
static double condition_of(const double linear[3][3], const double inverse[3][3])
{
    double most = 0.0;
    for (int row = 0; row < 3; row++) {
        double total = 0.0;
        for (int middle = 0; middle < 3; middle++) {
            for (int column = 0; column < 3; column++) {
                total += fabs(linear[row][middle] * inverse[middle][column]);
            }
        }
        most = max(most, total);
    }
    return most;
}

// The middle of an instance's box along an axis of the scene, and half its side.
static double2 box_along(
    const double row_of_map[3], const double offset, const double origin[3], const double half_size[3])
{
    double2 box = (double2)(offset, 0.0);
    for (int column = 0; column < 3; column++) {
        box.x += row_of_map[column] * origin[column];
        box.y += fabs(row_of_map[column]) * half_size[column];
    }
    return box;
}

// Writes the corners of the instances' boxes in the scene's coordinates.
loop void find_boxes(
    const long count, const int geometry_id[count], const double linear[count][3][3], const double offset[count][3],
    const double inverse[count][3][3], const long geometry_count, const double origin[geometry_count][3],
    const double half_size[geometry_count][3], double lower[count][3], double upper[count][3])
{
    for (long instance = 0; instance < count; instance++) {
        const int geometry = geometry_id[instance];
        const double condition = condition_of(linear[instance], inverse[instance]);
        for (int row = 0; row < 3; row++) {
            const double2 box =
                box_along(linear[instance][row], offset[instance][row], origin[geometry], half_size[geometry]);
            const double half_side = box.y + box.y * min(OWN_GROWTH * condition, 1.0);
            lower[instance][row] = box.x - half_side;
            upper[instance][row] = box.x + half_side;
        }
    }
}

// Writes the records of the instances in an order; returns the first instance that is too small, or -1.
//
// scale               of each geometry
// ranges, masks       see `make_records`
// centre, world_scale those of the world
// most_inverse        what no entry of the map to the object may exceed
// records             zeros before
loop int write_records(
    const long count, const int order[count], const int geometry_id[count], const double linear[count][3][3],
    const double offset[count][3], const double inverse[count][3][3], const uint masks[count],
    const long geometry_count, const double origin[geometry_count][3], const double half_size[geometry_count][3],
    const double scale[geometry_count], const int ranges[geometry_count][4], const double centre[3],
    const double world_scale, const double most_inverse, instance_t records[count])
{
    for (long slot = 0; slot < count; slot++) {
        const int instance = order[slot];
        const int geometry = geometry_id[instance];
        instance_t *record = records + slot;
        double squared_radius = 0.0;
        for (int row = 0; row < 3; row++) {
            const double2 box =
                box_along(linear[instance][row], offset[instance][row], origin[geometry], half_size[geometry]);
            for (int column = 0; column < 3; column++) {
                record->to_world[row][column] = (float)(linear[instance][row][column] / scale[geometry] * world_scale);
                const double back = inverse[instance][row][column] / world_scale * scale[geometry];
                // Written so that NaN is too large.
                if (!(fabs(back) <= most_inverse)) {
                    return instance;
                }
                record->to_object[row][column] = (float)back;
            }
            squared_radius += box.y * world_scale * (box.y * world_scale);
            const double local_place = (box.x - centre[row]) * world_scale;
            record->centre[row] = (float)local_place;
            record->centre_low[row] = (float)(local_place - record->centre[row]);
        }
        record->radius = (float)(sqrt(squared_radius) * ROOM);
        record->first_node = ranges[geometry][0];
        record->first_block = ranges[geometry][1];
        record->block_count = ranges[geometry][2];
        record->kind = ranges[geometry][3];
        record->mask = masks[instance];
        record->instance_id = instance;
    }
    return -1;
}
