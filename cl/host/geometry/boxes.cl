// Boxes of spheres, by clbvh/geometry/spheres.py.

// A box grows by this share of its sphere's radius: the rounding of the sphere test, see docs/internals/padding.md.
#define MARGIN 0x1p-18

// How far rounding to float32 moves a coordinate: a share of it, a little more than 2^-24, and as much for the numbers
// below the normal ones.
#define ROUNDING_OF(x) (fabs(x) * (0x1p-24 + 0x1p-40) + 0x1p-149)

// Writes the two corners of each box, rounded outwards.
loop void bound_spheres(
    const long count, const float centres[count][3], const float radii[count], float corners[count][2][3])
{
    for (long sphere = 0; sphere < count; sphere++) {
        const double reach = radii[sphere] * (1.0 + MARGIN);
        for (int axis = 0; axis < 3; axis++) {
            const double lower = centres[sphere][axis] - reach;
            const double upper = centres[sphere][axis] + reach;
            corners[sphere][0][axis] = (float)(lower - ROUNDING_OF(lower));
            corners[sphere][1][axis] = (float)(upper + ROUNDING_OF(upper));
        }
    }
}
