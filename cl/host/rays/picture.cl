// Whether rays are a picture, and how long its rows are, by clbvh/trace/rays/coherence.py.

#include "rays/given.cl"

#define MOST_ROW_LENGTH (1 << 16)

// Two rays are near each other if they are at most this many mean steps from ray to ray apart: pixels may be oblong,
// and rays jittered.
#define NEAR_STEPS 8

// Rows sampled; this many must have a nearby next row. At the poles of a scan all around, rows are short.
#define ROW_SAMPLES 32
#define LEAST_GOOD_SAMPLES 24

static double distance_of(const given_rays_t *rays, const long one, const long other)
{
    const wide_ray_t a = read_ray(rays, one);
    const wide_ray_t b = read_ray(rays, other);
    const double3 origin = a.origin - b.origin;
    const double3 direction = a.direction - b.direction;
    // In this order, axis by axis.
    double squares = origin.x * origin.x;
    squares += direction.x * direction.x;
    squares += origin.y * origin.y;
    squares += direction.y * direction.y;
    squares += origin.z * origin.z;
    squares += direction.z * direction.z;
    return sqrt(squares);
}

// The length of rows, of this one and the next ones, for which the next row is nearest.
static long nearest_row(const given_rays_t *rays, const long count, const long row_length)
{
    long nearest = row_length;
    double least = INFINITY;
    // The jump at the end of a row makes mean steps look twice as long, so "near" may reach twice as far, before the
    // row and behind it.
    for (long candidate = row_length; candidate <= row_length + 4 * NEAR_STEPS; candidate++) {
        double total = 0.0;
        for (int sample = 0; sample < ROW_SAMPLES; sample++) {
            const long ray = sample * (count - 1 - candidate) / ROW_SAMPLES;
            total += distance_of(rays, ray, ray + candidate);
        }
        if (total < least) {
            nearest = candidate;
            least = total;
        }
    }
    return nearest;
}

// The number of rays after which a walk from the middle of the batch comes back to its beginning; 0 if it does not.
static long find_return(const given_rays_t *rays, const long count, const long least_row_length, const long least_rows)
{
    const long begin = count / 2;
    double travelled = 0.0;
    bool was_away = false;
    for (long row_length = 1; row_length <= min(count / least_rows, (long)MOST_ROW_LENGTH); row_length++) {
        travelled += distance_of(rays, begin + row_length - 1, begin + row_length);
        const double near = NEAR_STEPS * travelled / row_length;
        const double distance = distance_of(rays, begin, begin + row_length);
        if (was_away && distance <= near) {
            return row_length >= least_row_length ? nearest_row(rays, count, row_length) : 0;
        }
        // Written so that NaN is not away.
        was_away = was_away || distance > near;
    }
    return 0;
}

// Whether the next row is near for enough samples, and the middle of a row far from its beginning.
static bool are_rows_near(const given_rays_t *rays, const long count, const long row_length)
{
    const long row_count = count / row_length;
    const long half_row = row_length / 2;
    int good = 0;
    for (int sample = 0; sample < ROW_SAMPLES; sample++) {
        const long begin = sample * (row_count - 1) / ROW_SAMPLES * row_length;
        double travelled = 0.0;
        for (long ray = begin; ray < begin + half_row; ray++) {
            travelled += distance_of(rays, ray, ray + 1);
        }
        const double near = NEAR_STEPS * travelled / half_row;
        const long ray = begin + half_row * sample / ROW_SAMPLES;
        good += distance_of(rays, begin, begin + half_row) > near && distance_of(rays, ray, ray + row_length) <= near;
    }
    return good >= LEAST_GOOD_SAMPLES;
}

// Returns the number of rays in a row if the rays are a picture, 0 if they are none.
loop long find_row_length(
    const ulong *rays, const long first_ray, const long count, const long least_row_length, const long least_rows)
{
    const given_rays_t given = rays_from(rays, first_ray);
    const long row_length = find_return(&given, count, least_row_length, least_rows);
    return row_length > 0 && are_rows_near(&given, count, row_length) ? row_length : 0;
}
