// Right-handed frames of unit vectors around a normal, in which directions are sampled around z.

#include "math/vectors.cl"

typedef struct {
    float3 tangent;
    float3 bitangent;
    float3 normal;
} frame_t;

// Assumes a normal of length 1. It is continuous but for z = 0, and as precise as the normal everywhere (Duff, Burgess,
// Christensen, Hery, Kensler, Liani and Villemin, "Building an orthonormal basis, revisited", Journal of Computer
// Graphics Techniques 6(1), 2017).
INLINED frame_t frame_around(const float3 normal)
{
    const float sign = normal.z < 0.0f ? -1.0f : 1.0f;
    const float a = -1.0f / (sign + normal.z);
    const float b = normal.x * normal.y * a;
    const frame_t frame = {
        (float3)(1.0f + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        (float3)(b, sign + normal.y * normal.y * a, -normal.y), normal};
    return frame;
}

// A vector in the frame's coordinates, z along the normal, as one outside. For single numbers, see sampling/warps.cl.
INLINED float3 from_frame(const frame_t *frame, const float3 v)
{
    return (float3)(
        v.x * frame->tangent.x + v.y * frame->bitangent.x + v.z * frame->normal.x,
        v.x * frame->tangent.y + v.y * frame->bitangent.y + v.z * frame->normal.y,
        v.x * frame->tangent.z + v.y * frame->bitangent.z + v.z * frame->normal.z);
}

// The inverse of from_frame.
INLINED float3 to_frame(const frame_t *frame, const float3 v)
{
    return (float3)(
        dot_product(v, frame->tangent), dot_product(v, frame->bitangent), dot_product(v, frame->normal));
}
