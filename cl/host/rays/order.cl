// The order in which rays are cast, by clbvh/trace/rays/coherence.py; eight rays at a time.
//
// Cells are found in float32, without branches. Comparisons are written so that NaN, of a ray in a face of the box,
// changes nothing and falls into the first cell.

#include "rays/given.cl"

#define LANES 8

// Above the 24 bits of the others: these rays come last.
#define LAST_KEY (1 << 24)

typedef struct {
    double centre[3];      // the file's coordinates
    double scale;          // local units in one unit of the file
    float half_size[3];    // local units, as all that follows
    float cells_per_unit[3];
    float last_cell;       // cells along each axis, less 1
} grid_t;

// See `make_grid`.
static grid_t load_grid(const double *numbers)
{
    grid_t grid = {.scale = numbers[3], .last_cell = numbers[10]};
    for (int axis = 0; axis < 3; axis++) {
        grid.centre[axis] = numbers[axis];
        grid.half_size[axis] = numbers[4 + axis];
        grid.cells_per_unit[axis] = numbers[7 + axis];
    }
    return grid;
}

// Where rays enter and leave the box.
typedef struct {
    int8 entries[3];  // cells along each axis
    int8 exits[3];
    int8 misses;
} crossings_t;

// The numbers along an axis of the cells in which rays are at t.
INLINED int8 cells_at(const grid_t *grid, const int axis, const float8 origin, const float8 direction, const float8 t)
{
    const float8 cell = (origin + grid->half_size[axis] + t * direction) * grid->cells_per_unit[axis];
    const float8 least = cell > 0.0f ? cell : (float8)(0.0f);
    return __builtin_convertvector(least < grid->last_cell ? least : (float8)(grid->last_cell), int8);
}

// Returns the crossings of rays from `first` on; the last of `count` stands for those after it.
static crossings_t cross_box(const grid_t *grid, const given_rays_t *rays, const long first, const long count)
{
    double origins[3][LANES];
    float8 directions[3];
    float8 t_near;
    float8 t_far;
    for (int lane = 0; lane < LANES; lane++) {
        const wide_ray_t ray = read_ray(rays, min(first + lane, count - 1));
        origins[0][lane] = ray.origin.x;
        origins[1][lane] = ray.origin.y;
        origins[2][lane] = ray.origin.z;
        directions[0][lane] = (float)ray.direction.x;
        directions[1][lane] = (float)ray.direction.y;
        directions[2][lane] = (float)ray.direction.z;
        t_near[lane] = (float)(ray.t_min * grid->scale);
        t_far[lane] = (float)(ray.t_max * grid->scale);
    }
    float8 local_origins[3];
    for (int axis = 0; axis < 3; axis++) {
        for (int lane = 0; lane < LANES; lane++) {
            local_origins[axis][lane] = (float)((origins[axis][lane] - grid->centre[axis]) * grid->scale);
        }
        const float8 inverse = 1.0f / directions[axis];
        const float8 lower = (-grid->half_size[axis] - local_origins[axis]) * inverse;
        const float8 upper = (grid->half_size[axis] - local_origins[axis]) * inverse;
        const float8 near = inverse < 0.0f ? upper : lower;
        const float8 far = inverse < 0.0f ? lower : upper;
        t_near = near > t_near ? near : t_near;
        t_far = far < t_far ? far : t_far;
    }
    crossings_t crossings = {.misses = t_near > t_far};
    for (int axis = 0; axis < 3; axis++) {
        crossings.entries[axis] = cells_at(grid, axis, local_origins[axis], directions[axis], t_near);
        crossings.exits[axis] = cells_at(grid, axis, local_origins[axis], directions[axis], t_far);
    }
    return crossings;
}

// The 4 bits of cell numbers with five zeros between them, so that six numbers interleave.
INLINED int8 spread_by_six(const int8 cell)
{
    return (cell & 1) | (cell & 2) << 5 | (cell & 4) << 10 | (cell & 8) << 15;
}

// The 8 bits of cell numbers with two zeros between them, so that three numbers interleave.
INLINED int8 spread_by_three(int8 cell)
{
    cell = (cell | cell << 8) & 0x00F00F;
    cell = (cell | cell << 4) & 0x0C30C3;
    return (cell | cell << 2) & 0x249249;
}

// Writes the keys of rays: a Morton code of the cells where they enter and leave the box, or, in finer cells, of those
// where they leave it; and the last key for rays that miss the box.
//
// by_exit             whether the entries do not count
loop void write_keys(
    const ulong *rays, const long first_ray, const double grid[11], const int by_exit, const long count,
    int keys[count])
{
    const given_rays_t given = rays_from(rays, first_ray);
    const grid_t cells = load_grid(grid);
    for (long first = 0; first < count; first += LANES) {
        const crossings_t crossings = cross_box(&cells, &given, first, count);
        int8 key = (int8)(0);
        for (int axis = 0; axis < 3; axis++) {
            if (by_exit) {
                key |= spread_by_three(crossings.exits[axis]) << axis;
            } else {
                key |= spread_by_six(crossings.entries[axis]) << axis;
                key |= spread_by_six(crossings.exits[axis]) << axis + 3;
            }
        }
        key = crossings.misses ? (int8)(LAST_KEY) : key;
        for (int lane = 0; lane < LANES && first + lane < count; lane++) {
            keys[first + lane] = key[lane];
        }
    }
}

// Where cells neither are the same nor touch.
static int8 are_apart(const int8 one[3], const int8 other[3])
{
    int8 apart = (int8)(0);
    for (int axis = 0; axis < 3; axis++) {
        const int8 distance = one[axis] - other[axis];
        apart |= distance > 1 | distance < -1;
    }
    return apart;
}

// Each ray's cells in the place of its neighbour's.
static void swap_pairs(const int8 cells[3], int8 swapped[3])
{
    for (int axis = 0; axis < 3; axis++) {
        swapped[axis] = cells[axis].s10325476;
    }
}

// Writes which shares of the pairs of rays are more than a cell apart, of those that meet the box: where the rays of a
// pair enter it, where they leave it, and where rays of different pairs enter it.
//
// count               rays, two of each pair; a multiple of 16
// shares              written
loop void measure_apart(
    const ulong *rays, const long first_ray, const double grid[11], const long count, double shares[3])
{
    const given_rays_t given = rays_from(rays, first_ray);
    const grid_t cells = load_grid(grid);
    int considered = 0;
    int apart[3] = {0, 0, 0};
    for (long first = 0; first < count; first += LANES) {
        const crossings_t pairs = cross_box(&cells, &given, first, count);
        const crossings_t others = cross_box(&cells, &given, (first + count / 2) % count, count);
        int8 entries[3];
        int8 exits[3];
        swap_pairs(pairs.entries, entries);
        swap_pairs(pairs.exits, exits);
        const int8 is_alone = pairs.misses ^ pairs.misses.s10325476;
        const int8 is_met = ~(pairs.misses & pairs.misses.s10325476);
        const int8 found[3] = {
            is_alone | are_apart(pairs.entries, entries), is_alone | are_apart(pairs.exits, exits),
            are_apart(pairs.entries, others.entries)};
        for (int lane = 0; lane < LANES; lane += 2) {
            considered -= is_met[lane];
            for (int i = 0; i < 3; i++) {
                apart[i] -= found[i][lane] & is_met[lane];
            }
        }
    }
    for (int i = 0; i < 3; i++) {
        shares[i] = apart[i] / (double)max(considered, 1);
    }
}
