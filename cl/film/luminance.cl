// The luminance of a linear colour, see Rec. ITU-R BT.709.

#include "math/inlined.cl"

INLINED float luminance(const float3 colour)
{
    return 0.2126f * colour.x + 0.7152f * colour.y + 0.0722f * colour.z;
}
