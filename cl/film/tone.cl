// Tone curves: from any linear light to colours from 0 to 1, still linear.

#include "math/numeric.cl"

// A filmic curve: a toe, a straight part and a shoulder (Narkowicz, "ACES filmic tone mapping curve", 2016, a fit to
// the reference curve of the Academy Color Encoding System).
INLINED float3 map_filmic(const float3 light)
{
    const float3 x = clamp(light, 0.0f, 1e6f);
    return clamp(x * (2.51f * x + 0.03f) / (x * (2.43f * x + 0.59f) + 0.14f), 0.0f, 1.0f);
}
