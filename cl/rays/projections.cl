// Projections other than perspective: where a point of the picture is in the plane of its projection, and the direction
// that it shows.

#include "structs.cl"
#include "math/trigonometry.cl"

// Steps of Newton's method at most. The host refuses a lens for which they do not suffice.
#define UNDISTORT_STEPS 16

// A smaller step changes the point by less than its rounding.
#define UNDISTORT_DONE 1e-7f

// The point of the plane at distance 1 that a lens shows at (x, y), y upwards: the inverse of OpenCV's distortion, see
// clbvh/views/cameras/lens.py.
INLINED float2 undistort(const global float *coefficients, const float2 shown)
{
    const float k1 = coefficients[0];
    const float k2 = coefficients[1];
    const float p1 = coefficients[2];
    const float p2 = coefficients[3];
    const float k3 = coefficients[4];
    float u = shown.x;
    float v = shown.y;
    for (int step = 0; step < UNDISTORT_STEPS; step++) {
        const float square = u * u + v * v;
        const float bend = square * (k1 + square * (k2 + square * k3));
        const float radial = 1.0f + bend;
        const float slope = 2.0f * (k1 + square * (2.0f * k2 + square * (3.0f * k3)));
        const float off_x = (u - shown.x) + (u * bend + 2.0f * p1 * u * v + p2 * (square + 2.0f * u * u));
        const float off_y = (v - shown.y) + (v * bend + p1 * (square + 2.0f * v * v) + 2.0f * p2 * u * v);
        const float uu = radial + u * u * slope + 2.0f * p1 * v + 6.0f * p2 * u;
        const float uv = u * v * slope + 2.0f * p1 * u + 2.0f * p2 * v;
        const float vv = radial + v * v * slope + 6.0f * p1 * v + 2.0f * p2 * u;
        const float determinant = uu * vv - uv * uv;
        // Beyond the picture there may be no point.
        if (!(determinant > 0.0f)) {
            break;
        }
        const float step_u = (vv * off_x - uv * off_y) / determinant;
        const float step_v = (uu * off_y - uv * off_x) / determinant;
        u -= step_u;
        v -= step_v;
        if (fabs(step_u) + fabs(step_v) < UNDISTORT_DONE * (1.0f + fabs(u) + fabs(v))) {
            break;
        }
    }
    return (float2)(u, v);
}

CALLED float2 undistorted_point(const global view_t *view, const float2 film)
{
    const float y = view->centre[1] + film.y * view->half_size[1];
    const float x = view->centre[0] + film.x * view->half_size[0] + view->shear * y;
    return undistort(view->distortion, (float2)(x, y));
}

// The angle to the axis, z, grows with the distance from the middle of the picture. Returns whether the point is inside
// the circle of the image.
INLINED bool fisheye_direction(const global view_t *view, const float2 film, float3 *direction)
{
    const float2 point = (float2)(film.x * view->half_size[0], film.y * view->half_size[1]);
    const float radius = sqrt(point.x * point.x + point.y * point.y);
    const float2 turned = sin_cos_turns(view->half_angle * (radius < 1.0f ? radius : 1.0f));
    const float slope = radius > 0.0f ? turned.x / radius : 0.0f;
    *direction = (float3)(slope * point, turned.y);
    return radius <= 1.0f;
}

// x is the longitude, y the latitude; z is the middle of the picture.
INLINED float3 panorama_direction(const float2 film)
{
    const float2 longitude = sin_cos_turns(0.5f * film.x);
    const float2 latitude = sin_cos_turns(0.25f * film.y);
    return (float3)(longitude.x * latitude.y, latitude.x, longitude.y * latitude.y);
}
