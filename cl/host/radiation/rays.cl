// Rays that leave faces evenly, and counts of where they end, by clbvh/radiation/factors.py.

#include "math/doubles.cl"
#include "sampling/frame.cl"
#include "sampling/quads.cl"
#include "sampling/warps.cl"

// A fixed-point number in the middle of its interval, between 0 and 1.
INLINED double as_unit_double(const uint x)
{
    return ((double)x + 0.5) * 0x1p-32;
}

// The first of the faces from `begin` to `end` whose sum of areas is above a share of the whole.
INLINED long find_face(const double *sums, const long begin, const long end, const double share)
{
    long low = begin, high = end - 1;
    while (low < high) {
        const long middle = (low + high) / 2;
        if (sums[middle] > share) {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    return low;
}

// Draws the rays of the sources from `begin` to `end`: a face by its area, a point on it evenly, and a direction whose
// density is the cosine to the normal, around which the corners run anticlockwise.
//
// corners    of the faces, source after source
// begins     the first face of each source, and the number of all
// sums       areas of the faces of a source up to and with each, of that of all
// origins, directions    of the rays, source after source from `first` on
loop void draw_rays(
    const double corners[face_count][3][3], const long face_count, const long *begins, const double sums[face_count],
    const long first, const long begin, const long end, const long ray_count, const uint seed, double *origins,
    double *directions)
{
    for (long source = begin; source < end; source++) {
        const long first_face = begins[source], face_end = begins[source + 1];
        long framed = -1;
        frame_t frame = {0.0f, 0.0f, 0.0f};
        for (long ray = 0; ray < ray_count; ray++) {
            sobol_sampler_t sampler = make_sampler((uint)source, (uint)ray, seed);
            uint numbers[4];
            sample_quad(&sampler, numbers);
            const double share = as_unit_double(numbers[0]), across = as_unit_double(numbers[1]);
            const long face = find_face(sums, first_face, face_end, share);
            const double before = face > first_face ? sums[face - 1] : 0.0;
            const double along = min(max((share - before) / (sums[face] - before), 0.0), 1.0);
            const double3 a = vload3(3 * face, corners[0][0]), b = vload3(3 * face + 1, corners[0][0]),
                          c = vload3(3 * face + 2, corners[0][0]);
            if (face != framed) {
                const double3 normal = cross3(b - a, c - a);
                frame = frame_around(convert_float3(normal / sqrt(dot3(normal, normal))));
                framed = face;
            }
            // Even over the triangle (Turk, "Generating random points in triangles", Graphics Gems, 1990).
            const double root = sqrt(along);
            const double3 origin = a + root * ((1.0 - across) * (b - a) + across * (c - a));
            const float2 around = (float2)(as_unit_float(numbers[2]), as_unit_float(numbers[3]));
            const float3 direction = from_frame(&frame, sample_hemisphere(around));
            const long row = 3 * ((source - first) * ray_count + ray);
            for (int axis = 0; axis < 3; axis++) {
                origins[row + axis] = origin[axis];
                directions[row + axis] = (double)direction[axis];
            }
        }
    }
}

// Counts for each source how many of its rays end at each target.
//
// ends       the face where each ray ends, or -1
// labels     the target that a face belongs to, or -1; None: itself
// counts     zeros, one for each target; zeros again at the end
// targets, tallies    from the first place of a source's rays on: what they meet, and how often
// distinct   the number of targets of each source
// missed     rays of each source that meet nothing
loop void count_ends(
    const int *ends, const int *labels, const long ray_count, int *counts, int *targets, int *tallies,
    int distinct[source_count], int missed[source_count], const long source_count)
{
    for (long source = 0; source < source_count; source++) {
        const int *own = ends + source * ray_count;
        int *met = targets + source * ray_count, *tally = tallies + source * ray_count;
        int found = 0, lost = 0;
        for (long ray = 0; ray < ray_count; ray++) {
            const int face = own[ray];
            const int target = face < 0 || labels == 0 ? face : labels[face];
            lost += face < 0;
            if (target >= 0 && counts[target]++ == 0) {
                met[found++] = target;
            }
        }
        for (int i = 0; i < found; i++) {
            tally[i] = counts[met[i]];
            counts[met[i]] = 0;
        }
        distinct[source] = found;
        missed[source] = lost;
    }
}
