// Sines, cosines and angles in double, with errors of at most 0.51 units in the last place: as close as those of the C
// libraries, and the same wherever they are computed. Argument or quotient is split into the nearest multiple of 1/16,
// whose values are known to twice the digits, and a rest of at most 1/32, which is small enough for a short series.

#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

#define PARTS 16.0
#define PI_LOW 1.2246467991473532e-16
#define PI_HIGH 3.141592653589793

// A number and what its rounding has left off, subtracted from a larger one.
INLINED double2 subtract_pair(const double high, const double low, const double2 pair)
{
    const double difference = high - pair.x;
    return (double2)(difference, ((high - difference) - pair.x) + (low - pair.y));
}

// The angle in radians, from 0 to pi / 4, whose tangent is a / b; assumes 0 <= a <= b and b > 0. In two parts, of which
// the second is what rounding has left off the first.
INLINED double2 angle_of_quotient(const double a, const double b)
{
    const double angles[17][2] = {
        {0.0, 0.0},
        {0.06241880999595735, -1.5490756308295046e-18},
        {0.12435499454676144, -3.1253241424539383e-18},
        {0.18534794999569476, 4.180692268843079e-18},
        {0.24497866312686414, 1.0698755618734451e-17},
        {0.3028848683749714, -1.1010827903001369e-17},
        {0.35877067027057225, -2.4623815582638635e-17},
        {0.4124104415973873, -1.587652227770689e-17},
        {0.4636476090008061, 2.2698777452961687e-17},
        {0.5123894603107377, -2.5462781472855804e-17},
        {0.5585993153435624, -5.4556305485916264e-18},
        {0.6022873461349642, 2.950430737228402e-17},
        {0.6435011087932844, 1.5834785051444286e-17},
        {0.6823165548747481, 6.943223671560008e-18},
        {0.7188299996216245, -2.1478388444456983e-17},
        {0.7531512809621944, -2.4256934659182068e-17},
        {0.7853981633974483, 3.061616997868383e-17},
    };
    // By arctan(a / b) = arctan(c) + arctan((a - c b) / (b + c a)).
    const int nearest = (int)least_of(PARTS, PARTS * (a / b) + 0.5);  // NaN is the last
    const double c = nearest / PARTS;
    // Exact: the difference is small, and c has four digits.
    const double above = fma(-c, b, a);
    const double below = fma(c, a, b), below_rest = fma(c, a, b - below);
    const double r = above / below;
    const double r_rest = (fma(-r, below, above) - r * below_rest) / below;
    const double t = r * r;
    const double series = t * (-1.0 / 3.0 + t * (0.2 + t * (-1.0 / 7.0 + t * (1.0 / 9.0 + t * (-1.0 / 11.0)))));
    const double high = angles[nearest][0] + r;
    return (double2)(high, ((angles[nearest][0] - high) + r) + (angles[nearest][1] + (r_rest + r * series)));
}

// The angle of the vector (x, y) in radians, from -pi to pi: atan2, but for the signs of zeros.
INLINED double angle_of(const double y, const double x)
{
    const double width = fabs(x), height = fabs(y);
    double2 angle = (double2)(0.0);
    if (height > width) {
        angle = subtract_pair(0.5 * PI_HIGH, 0.5 * PI_LOW, angle_of_quotient(width, height));
    } else if (width > 0.0) {
        angle = angle_of_quotient(height, width);
    }
    if (x < 0.0) {
        angle = subtract_pair(PI_HIGH, PI_LOW, angle);
    }
    return y < 0.0 ? -(angle.x + angle.y) : angle.x + angle.y;
}

// A sine, or a cosine, moved on by an angle r.
//
// value, slope        of the function and of its derivative before, with what rounding has left off
// cosine, sine        cos(r) - 1 and sin(r) - r
INLINED double move_on(const double2 value, const double2 slope, const double r, const double cosine, const double sine)
{
    const double step = slope.x * r;
    const double high = value.x + step;
    const double rest = fma(slope.x, r, -step) + (value.y + slope.y * r);
    return high + (((value.x - high) + step) + (rest + (value.x * cosine + slope.x * sine)));
}

// Returns the sine in x and the cosine in y of an angle in radians, from -pi / 4 to pi / 4.
INLINED double2 sine_and_cosine(const double angle)
{
    // Sines and cosines of the multiples.
    const double known[14][4] = {
        {0.0, 0.0, 1.0, 0.0},
        {0.0624593178423802, -2.040259504585711e-18, 0.9980475107000991, 3.3232291674141346e-17},
        {0.12467473338522769, -2.925947496057858e-18, 0.992197667229329, 4.754870575189364e-17},
        {0.18640329676226988, 2.3493796901281573e-18, 0.9824733131012553, -3.919920375420088e-17},
        {0.24740395925452294, -7.53102495590706e-18, 0.9689124217106447, 5.071436662403936e-17},
        {0.30743851458038085, 1.1004366442765296e-19, 0.9515679480481722, -3.8614834675674123e-17},
        {0.36627252908604757, -9.938814562106524e-18, 0.9305076219123143, 4.488760003328074e-18},
        {0.42367625720393803, -2.331800700068871e-17, 0.9058136834259364, 4.2864666490805214e-17},
        {0.479425538604203, -5.103969860556013e-18, 0.8775825618903728, -4.2623149864279997e-17},
        {0.5333026735360201, 5.129318115032044e-17, 0.8459244992310679, 1.549506647350329e-17},
        {0.5850972729404622, -5.4883972461161805e-17, 0.8109631195052179, -3.091333486122179e-17},
        {0.6346070800152693, -3.4568582392624965e-17, 0.7728349461524715, 4.231014921891023e-17},
        {0.6816387600233341, 4.410467313197903e-17, 0.7316888688738209, -1.0475824306512768e-17},
        {0.7260086552607126, -1.573621815339587e-17, 0.6876855622205048, 3.5430696752823923e-17},
    };
    const double size = fabs(angle);
    const double nearest = floor(least_of(13.0, PARTS * size + 0.5));
    const double r = size - nearest / PARTS;
    const double *of_nearest = known[(int)nearest];
    const double2 sine = (double2)(of_nearest[0], of_nearest[1]), cosine = (double2)(of_nearest[2], of_nearest[3]);
    const double t = r * r;
    const double cosine_of_r = t * (-0.5 + t * (1.0 / 24.0 + t * (-1.0 / 720.0 + t * (1.0 / 40320.0))));
    const double sine_of_r = r * (t * (-1.0 / 6.0 + t * (1.0 / 120.0 + t * (-1.0 / 5040.0 + t * (1.0 / 362880.0)))));
    const double moved_sine = move_on(sine, cosine, r, cosine_of_r, sine_of_r);
    return (double2)(angle < 0.0 ? -moved_sine : moved_sine, move_on(cosine, -sine, r, cosine_of_r, sine_of_r));
}
