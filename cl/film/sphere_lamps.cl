// Lamps that are spheres. From outside, directions are drawn evenly within the cone that the sphere subtends (Shirley,
// Wang and Zimmerman, "Monte Carlo techniques for direct lighting calculations", 1996): none of them misses it, and the
// light along each is the same.
//
// From inside, points are drawn evenly on the sphere: for those who stand on its wall, that is by the cosine of the
// wall's normal, and in the middle it is evenly over all directions.

#include "math/vectors.cl"
#include "sampling/frame.cl"
#include "sampling/warps.cl"

#define SPHERE_PI 3.14159265f

// Positions up to this squared distance from the centre, in squared radii, count as inside: those on the wall of a
// sphere are there but for rounding.
#define INSIDE_SHARE 1.001f

INLINED bool is_outside(const float distance_squared, const float radius)
{
    return distance_squared > INSIDE_SHARE * radius * radius;
}

// 1 - cos of half the apex angle of the cone from a position outside. The cosine of a distant sphere is 1 in float32.
INLINED float cone_width(const float distance_squared, const float radius)
{
    const float sine_squared = radius * radius / distance_squared;
    return sine_squared / (1.0f + square_root(1.0f - sine_squared));
}

// The density of directions within a cone, per solid angle.
INLINED float cone_density(const float width)
{
    return 1.0f / (2.0f * SPHERE_PI * width);
}

// The density of points on a sphere, as one of directions from a position.
INLINED float wall_density(const float radius, const float distance_squared, const float cosine)
{
    return distance_squared / (4.0f * SPHERE_PI * radius * radius * larger(cosine, 1e-8f));
}

// The density with which sample_sphere_lamp finds the point of a sphere that a ray has met, by the way to it from the
// ray's origin and the unit vector from the centre to it.
INLINED float sphere_lamp_density(const float radius, const float3 way, const float3 outward)
{
    const float3 to_centre = way - radius * outward;
    const float squared = dot_product(to_centre, to_centre);
    if (is_outside(squared, radius)) {
        return cone_density(cone_width(squared, radius));
    }
    const float distance_squared = dot_product(way, way);
    const float cosine = absolute(dot_product(way, outward)) / square_root(larger(distance_squared, 1e-30f));
    return wall_density(radius, distance_squared, cosine);
}

// Draws a direction to a sphere, whose centre is `to_centre` away. Returns its density, and in *distance that of the
// sphere along it; 0 where there is no direction.
INLINED float sample_sphere_lamp(
    const float3 to_centre, const float radius, const float2 sample, float3 *direction, float *distance)
{
    const float squared = dot_product(to_centre, to_centre);
    if (is_outside(squared, radius)) {
        const float to_middle = square_root(squared);
        const float width = cone_width(squared, radius);
        const float3 within = sample_cone(sample, width);
        const frame_t frame = frame_around(to_centre / to_middle);
        *direction = from_frame(&frame, within);
        const float aside_squared = squared * (within.x * within.x + within.y * within.y);
        const float half_chord = square_root(larger(radius * radius - aside_squared, 0.0f));
        // The smaller root of t^2 - 2 t d cos + d^2 - r^2, without the cancellation of a position close to the sphere.
        *distance = (squared - radius * radius) / (to_middle * within.z + half_chord);
        return cone_density(width);
    }
    const float3 outward = sample_sphere(sample);
    const float3 way = to_centre + radius * outward;
    const float distance_squared = dot_product(way, way);
    if (!(distance_squared > 0.0f)) {
        return 0.0f;
    }
    *distance = square_root(distance_squared);
    *direction = way / *distance;
    return wall_density(radius, distance_squared, absolute(dot_product(outward, *direction)));
}
