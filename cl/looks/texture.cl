// Textures: rows of 8-bit texels from the top, read with bilinear interpolation, or as squares.

#include "structs.cl"
#include "math/numeric.cl"

typedef struct {
    const global texture_t *textures;
    const global uint *texels;
    const global float *decoded_srgb;
} texture_tables_t;

// Red, green, blue and alpha from 0 to 1; linear.
INLINED float4 decode_colour(const texture_tables_t *tables, const uint texel, const bool is_srgb)
{
    const uint4 bytes = (uint4)(texel & 0xffu, texel >> 8 & 0xffu, texel >> 16 & 0xffu, texel >> 24);
    if (is_srgb) {
        const global float *decoded = tables->decoded_srgb;
        return (float4)(decoded[bytes.x], decoded[bytes.y], decoded[bytes.z], bytes.w * (1.0f / 255.0f));
    }
    return convert_float4(bytes) * (1.0f / 255.0f);
}

// The column or row of a texel that may lie beyond the edges.
INLINED int wrap_index(const int index, const int size, const int wrap)
{
    if (wrap == WRAP_CLAMP) {
        return clamp(index, 0, size - 1);
    }
    const int period = wrap == WRAP_MIRROR ? 2 * size : size;
    int inside = index % period;
    inside += inside < 0 ? period : 0;
    return inside < size ? inside : period - 1 - inside;
}

// The index before a position, and in *fraction how far it is on the way to the next one. Positions that no texture
// needs, such as NaN and 1e30, become 0.
INLINED int split_position(const float position, float *fraction)
{
    const float safe = position > -1e6f && position < 1e6f ? position : 0.0f;
    const float begin = round_down(safe);
    *fraction = safe - begin;
    return (int)begin;
}

// The colour at uv; (0, 0) is the lower left corner.
CALLED float4 sample_texture(const texture_tables_t *tables, const int texture_id, const float2 uv)
{
    const global texture_t *texture = tables->textures + texture_id;
    const int width = texture->width;
    const int height = texture->height;
    // Of squares, the texel at uv has all the weight; the others are read for nothing, which takes no branch.
    const float centre = texture->is_nearest ? 0.0f : 0.5f;
    float right, down;
    const int column = split_position(uv.x * width - centre, &right);
    const int row = split_position((1.0f - uv.y) * height - centre, &down);
    if (texture->is_nearest) {
        right = 0.0f;
        down = 0.0f;
    }
    float4 sum = (float4)(0.0f);
    for (int corner = 0; corner < 4; corner++) {
        const int x = wrap_index(column + (corner & 1), width, texture->wrap[0]);
        const int y = wrap_index(row + (corner >> 1), height, texture->wrap[1]);
        const float weight = (corner & 1 ? right : 1.0f - right) * (corner >> 1 ? down : 1.0f - down);
        const uint texel = tables->texels[texture->first_texel + y * width + x];
        sum += weight * decode_colour(tables, texel, texture->is_srgb != 0);
    }
    return sum;
}
