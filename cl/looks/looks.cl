// How surfaces look: their colours, shading normals and materials, from tables with a row for each corner of each
// triangle. Any table may be empty, and its first index in `look_t` -1.
//
// looks[instance_count]          look_t by instance_id; a mesh without a scene has one
// corner_normals[], corner_colours[]      uint for each corner: a unit vector, see decode_normal; red, green, blue and
//                                alpha, 8 bits each, sRGB. Among the normals are tangents, the direction in which u
//                                grows, with 1 in the lowest bit where the texture is mirrored; and FLAT_FACE for the
//                                first corner of a face whose corners have its own normal
// corner_uvs[]                   float2 for each corner
// material_ids[]                 int for each primitive
// materials[], textures[]        material_t, texture_t
// texels[]                       uint: red, green, blue and alpha, 8 bits each, red the lowest
// decoded_srgb[256]              float: the linear value of each 8-bit sRGB value
//
// HAS_NORMAL_MAPS, if defined as 1: some material has a texture of normals.

#include "looks/texture.cl"
#include "world/surface.cl"

// The material of shapes that have none; its colour is the picture's own.
#define DEFAULT_MATERIAL 0

typedef struct {
    const global look_t *looks;
    const global uint *corner_normals;
    const global uint *corner_colours;
    const global float *corner_uvs;
    const global int *material_ids;
    const global material_t *materials;
    texture_tables_t textures;
    const global float *default_colour;  // [3]
} looks_t;

// How far a shading normal that faces away is moved to this side: the cosine of 89.4 degrees.
#define GRAZING 0.01f

// A point of a surface as light sees it.
typedef struct {
    float3 normal;         // shading normal: unit vector on the side of the ray's origin
    float3 smooth_normal;  // the same before a texture bends it: rays to light start around it
    float3 lift;           // from the triangle to the smooth surface that it stands for, see world_lift
    float coat_cosine;     // of the corners' normals to the eye, the largest one; 0 without them: see make_bsdf
    float3 base_colour;    // linear
    float alpha;           // the share of light that the surface stops, after the cut-off
    float metallic;
    float roughness;
    float ior;
    float transmission;
    float3 emission;
    bool is_light;         // whether paths draw the emitting surface as a light
} appearance_t;

// A unit vector from two 16-bit numbers: an octahedron unfolded to a square (Cigolle et al., "A survey of efficient
// representations for independent unit vectors", 2014).
INLINED float3 decode_normal(const uint packed)
{
    const float x = (float)(int)(packed & 0xffffu) * (2.0f / 65534.0f) - 1.0f;
    const float y = (float)(int)(packed >> 16) * (2.0f / 65534.0f) - 1.0f;
    const float z = 1.0f - absolute(x) - absolute(y);
    // The lower half is folded outwards over the edges of the upper one.
    const float fold = larger(-z, 0.0f);
    return short_unit_vector((float3)(x < 0.0f ? x + fold : x - fold, y < 0.0f ? y + fold : y - fold, z));
}

// The texture coordinates where a ray meets a surface.
INLINED float2 uv_at(const looks_t *looks, const global look_t *look, const world_surface_t *surface)
{
    const global float *corners = looks->corner_uvs + look->first_uv + 6 * surface->prim_id;
    return (1.0f - surface->u - surface->v) * (float2)(corners[0], corners[1])
        + surface->u * (float2)(corners[2], corners[3]) + surface->v * (float2)(corners[4], corners[5]);
}

#if HAS_NORMAL_MAPS

// A normal that the material's texture bends, in the coordinates of the mesh. On the back, where the normal is turned
// round, the tangents are as well: there the bent surface is the same one, seen from behind.
INLINED float3 bend_normal(
    const looks_t *looks, const global look_t *look, const global material_t *material,
    const world_surface_t *surface, const float3 normal)
{
    const global uint *corners = looks->corner_normals + look->first_tangent + 3 * surface->prim_id;
    const float3 smooth = unit_vector(normal);
    const float3 mean = (1.0f - surface->u - surface->v) * decode_normal(corners[0])
        + surface->u * decode_normal(corners[1]) + surface->v * decode_normal(corners[2]);
    const float3 along_u = unit_vector(mean - dot_product(mean, smooth) * smooth);
    const float3 along_v = cross_product(smooth, along_u);
    const float3 texel =
        sample_texture(&looks->textures, material->normal_texture, uv_at(looks, look, surface)).xyz;
    const float3 bend = 2.0f * texel - 1.0f;
    const float side = surface->is_back ? -material->normal_scale : material->normal_scale;
    // The cross product of a normal that is turned round has turned by itself.
    const float side_of_v = corners[0] & 1u ? -material->normal_scale : material->normal_scale;
    return side * bend.x * along_u + side_of_v * bend.y * along_v + bend.z * smooth;
}

#endif

// A shading normal on the side of the ray's origin, where the geometric one is.
INLINED float3 turn_to_eye(const float3 shading_normal, const world_surface_t *surface, const float3 direction)
{
    float3 normal = shading_normal;
    // A normal that faces away, as near a silhouette, is moved to just on this side (Keller et al., "The iray light
    // transport simulation and rendering system", 2017, has the same idea for reflections).
    const float facing = dot_product(normal, direction);
    if (!(facing < 0.0f)) {
        normal = unit_vector(normal - (facing + GRAZING) * direction);
    }
    return dot_product(normal, surface->normal) > 0.0f ? normal : surface->normal;
}

// Finds the shading normals of a triangle with normals at its corners, or the geometric one, and the lift.
INLINED void find_normals(
    const looks_t *looks, const global look_t *look, const global material_t *material, const world_t *world,
    const search_t *search, const world_surface_t *surface, const float3 direction, appearance_t *found)
{
    found->normal = surface->normal;
    found->smooth_normal = surface->normal;
    found->lift = (float3)(0.0f);
    found->coat_cosine = 0.0f;
    if (look->first_normal < 0) {
        return;
    }
    const global uint *corners = looks->corner_normals + look->first_normal + 3 * surface->prim_id;
    if (corners[0] == FLAT_FACE) {
        return;
    }
    const float sign = surface->is_back ? -1.0f : 1.0f;
    const float3 at_corner[3] = {
        sign * decode_normal(corners[0]), sign * decode_normal(corners[1]), sign * decode_normal(corners[2])};
    found->lift = world_lift(world, search, at_corner);
    const float3 own = (1.0f - surface->u - surface->v) * at_corner[0] + surface->u * at_corner[1]
        + surface->v * at_corner[2];
    found->smooth_normal = turn_to_eye(unit_vector(place_normal(world, search, own)), surface, direction);
    found->normal = found->smooth_normal;
    for (int corner = 0; corner < 3; corner++) {
        const float3 placed = place_unit_normal(world, search, at_corner[corner]);
        found->coat_cosine = larger(found->coat_cosine, -dot_product(placed, direction));
    }
#if HAS_NORMAL_MAPS
    if (look->first_tangent >= 0 && material->normal_texture >= 0) {
        const float3 bent = bend_normal(looks, look, material, surface, own);
        found->normal = turn_to_eye(unit_vector(place_normal(world, search, bent)), surface, direction);
    }
#endif
}

// The appearance of the surface that a ray has met.
CALLED appearance_t appearance_at(
    const looks_t *looks, const world_t *world, const search_t *search, const world_surface_t *surface,
    const float3 direction)
{
    const global look_t *look = looks->looks + surface->instance_id;
    const int first_id = look->first_material_id;
    const int material_id = first_id >= 0 ? looks->material_ids[first_id + surface->prim_id] : look->material_id;
    const global material_t *material = looks->materials + material_id;
    const float w = 1.0f - surface->u - surface->v;

    appearance_t found;
    find_normals(looks, look, material, world, search, surface, direction, &found);
    found.base_colour = load3(
        look->has_colour                    ? look->colour
        : material_id == DEFAULT_MATERIAL ? looks->default_colour : material->base_colour);
    found.alpha = material->alpha;
    found.metallic = material->metallic;
    found.roughness = material->roughness;
    found.ior = material->ior;
    found.transmission = material->transmission;
    found.emission = load3(material->emission);
    found.is_light = look->is_light && material->is_light;

    if (look->first_colour >= 0 && !look->has_colour) {
        const global uint *corners = looks->corner_colours + look->first_colour + 3 * surface->prim_id;
        const float4 tint = w * decode_colour(&looks->textures, corners[0], true)
            + surface->u * decode_colour(&looks->textures, corners[1], true)
            + surface->v * decode_colour(&looks->textures, corners[2], true);
        found.base_colour *= tint.xyz;
        found.alpha *= tint.w;
    }
    if (look->first_uv >= 0) {
        const float2 uv = uv_at(looks, look, surface);
        if (material->base_colour_texture >= 0 && !look->has_colour) {
            const float4 texel = sample_texture(&looks->textures, material->base_colour_texture, uv);
            found.base_colour *= texel.xyz;
            found.alpha *= texel.w;
        }
        if (material->metallic_roughness_texture >= 0) {
            const float4 texel = sample_texture(&looks->textures, material->metallic_roughness_texture, uv);
            found.roughness *= texel.y;
            found.metallic *= texel.z;
        }
        if (material->emission_texture >= 0) {
            found.emission *= sample_texture(&looks->textures, material->emission_texture, uv).xyz;
        }
    }
    if (material->alpha_cutoff >= 0.0f) {
        found.alpha = found.alpha < material->alpha_cutoff ? 0.0f : 1.0f;
    }
    return found;
}
