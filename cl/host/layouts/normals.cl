// Unit vectors in 32 bits, by clbvh/layouts/pack_normals.py.

// The two lowest bits of a coordinate of 0 must not differ: an even number of steps has a middle.
#define STEPS 65534

loop void pack_normals(const long count, const float normals[count][3], uint packed[count])
{
    for (long i = 0; i < count; i++) {
        const double whole = fabs((double)normals[i][0]) + fabs((double)normals[i][1]) + fabs((double)normals[i][2]);
        const double size = whole > 0.0 ? whole : 1.0;
        const double x = whole > 0.0 ? normals[i][0] / size : 0.0;
        const double y = whole > 0.0 ? normals[i][1] / size : 0.0;
        const bool is_below = normals[i][2] < 0.0f;
        const double column = is_below ? (1.0 - fabs(y)) * (x >= 0.0 ? 1.0 : -1.0) : x;
        const double row = is_below ? (1.0 - fabs(x)) * (y >= 0.0 ? 1.0 : -1.0) : y;
        packed[i] = (uint)(0.5 * (column + 1.0) * STEPS + 0.5) | (uint)(0.5 * (row + 1.0) * STEPS + 0.5) << 16;
    }
}
