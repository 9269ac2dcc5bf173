// How a surface scatters light: a diffuse base, a specular coat or a metal, and glass, with the parameters of glTF 2.0.
//
// Directions are in the frame of the shading normal, z along it, and point away from the surface. Reflection is that of
// microfacets with the distribution GGX (Walter, Marschner, Li and Torrance, "Microfacet models for refraction through
// rough surfaces", 2007), without light that is reflected between facets.

#include "film/luminance.cl"
#include "looks/looks.cl"
#include "sampling/warps.cl"

#define PI 3.14159265f

// A smoother surface is a mirror: its highlight would be narrower than float32 resolves.
#define SMOOTH_ALPHA 1e-3f

// What is left out of a direction that is nearly in the surface.
#define LEAST_COSINE 1e-6f

typedef struct {
    float3 base_colour;
    float metallic;
    float transmission;
    float alpha;       // of GGX: the square of the roughness
    float ior_ratio;   // index of refraction behind the surface, divided by that before it
    float diffuse_share;
    float specular_share;  // probabilities of the lobes; transmission has the rest
    float eye_reflectance; // of the boundary, towards the eye
    float coat_share;      // by which the reflectance of the coat of a facet is reduced
    bool is_matte;         // the diffuse base alone: no coat, no metal, no glass
} bsdf_t;

typedef struct {
    float3 direction;
    float3 weight;     // scattered light times cosine, divided by the density
    float density;     // per solid angle; 0 where no other way of sampling finds the direction
    bool is_below;     // whether the direction goes through the surface
} scattered_t;

// Reflectance of the boundary between two media, at a cosine from 0 to 1. Beyond the critical angle it is 1.
INLINED float dielectric_reflectance(const float cosine, const float ior_ratio)
{
    const float refracted_squared = 1.0f - (1.0f - cosine * cosine) / (ior_ratio * ior_ratio);
    if (!(refracted_squared > 0.0f)) {
        return ior_ratio == 1.0f ? 0.0f : 1.0f;
    }
    const float refracted = square_root(refracted_squared);
    const float parallel = (ior_ratio * cosine - refracted) / (ior_ratio * cosine + refracted);
    const float perpendicular = (cosine - ior_ratio * refracted) / (cosine + ior_ratio * refracted);
    return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}

// The reflectance of a facet at a cosine, of which that of a dielectric is known.
INLINED float3 blend_reflectance(const bsdf_t *bsdf, const float cosine, const float dielectric)
{
    // Schlick, "An inexpensive BRDF model for physically-based rendering", 1994.
    const float rest = 1.0f - cosine;
    const float fifth = rest * rest * rest * rest * rest;
    const float3 metal = bsdf->base_colour + (1.0f - bsdf->base_colour) * fifth;
    return blend((float3)(dielectric), metal, bsdf->metallic);
}

INLINED float3 find_reflectance(const bsdf_t *bsdf, const float cosine)
{
    return blend_reflectance(bsdf, cosine, bsdf->coat_share * dielectric_reflectance(cosine, bsdf->ior_ratio));
}

INLINED bool is_mirror(const bsdf_t *bsdf)
{
    return bsdf->alpha < SMOOTH_ALPHA;
}

INLINED bsdf_t make_bsdf(const appearance_t *look, const bool is_back, const float3 to_eye)
{
    bsdf_t bsdf;
    bsdf.base_colour = look->base_colour;
    bsdf.metallic = look->metallic;
    bsdf.transmission = look->transmission;
    bsdf.alpha = look->roughness * look->roughness;
    bsdf.coat_share = 1.0f;
    bsdf.ior_ratio = is_back && look->transmission > 0.0f ? 1.0f / look->ior : look->ior;
    bsdf.is_matte = look->metallic == 0.0f && look->transmission == 0.0f && look->ior == 1.0f;
    if (bsdf.is_matte) {
        bsdf.diffuse_share = 1.0f;
        bsdf.specular_share = bsdf.eye_reflectance = 0.0f;
        return bsdf;
    }
    bsdf.eye_reflectance = dielectric_reflectance(to_eye.z, bsdf.ior_ratio);
    if (look->transmission == 0.0f && look->coat_cosine > to_eye.z) {
        // A facet at the silhouette of a round surface shows normals at right angles to the eye over all its width,
        // where a coat would leave it dark. It reflects as where the facet's normals are turned most to the eye.
        const float grazing = 1.0f - to_eye.z;
        const float cosine = to_eye.z + grazing * grazing * grazing * grazing * (look->coat_cosine - to_eye.z);
        const float reflectance = dielectric_reflectance(cosine, bsdf.ior_ratio);
        if (reflectance < bsdf.eye_reflectance) {
            bsdf.coat_share = reflectance / bsdf.eye_reflectance;
            bsdf.eye_reflectance = reflectance;
        }
    }
    const float specular = luminance(blend_reflectance(&bsdf, to_eye.z, bsdf.eye_reflectance));
    const float rest = (1.0f - bsdf.metallic) * (1.0f - bsdf.eye_reflectance);
    const float diffuse = rest * (1.0f - bsdf.transmission) * luminance(bsdf.base_colour);
    const float through = rest * bsdf.transmission;
    const float sum = specular + diffuse + through;
    bsdf.diffuse_share = sum > 0.0f ? diffuse / sum : 1.0f;
    bsdf.specular_share = sum > 0.0f ? specular / sum : 0.0f;
    return bsdf;
}

// Smith's lambda: facets that are hidden, for each that is seen from a direction.
INLINED float hidden_facets(const float alpha, const float3 direction)
{
    const float slope_squared =
        alpha * alpha * (direction.x * direction.x + direction.y * direction.y) / (direction.z * direction.z);
    return 0.5f * (square_root(1.0f + slope_squared) - 1.0f);
}

// A normal of a facet that is seen from a direction (Heitz, "Sampling the GGX distribution of visible normals", 2018).
INLINED float3 sample_facet(const float alpha, const float3 to_eye, const float2 sample)
{
    const float3 stretched = unit_vector((float3)(alpha * to_eye.x, alpha * to_eye.y, to_eye.z));
    const float level = stretched.x * stretched.x + stretched.y * stretched.y;
    const float3 across =
        level > 0.0f ? (float3)(-stretched.y, stretched.x, 0.0f) / square_root(level) : (float3)(1.0f, 0.0f, 0.0f);
    const float3 along = cross_product(stretched, across);
    const float radius = square_root(sample.x);
    const float2 turned = sin_cos_turns(sample.y);
    const float x = radius * turned.y;
    const float share = 0.5f * (1.0f + stretched.z);
    const float y = (1.0f - share) * square_root(larger(1.0f - x * x, 0.0f)) + share * radius * turned.x;
    const float z = square_root(larger(1.0f - x * x - y * y, 0.0f));
    const float3 normal = x * across + y * along + z * stretched;
    return unit_vector((float3)(alpha * normal.x, alpha * normal.y, larger(normal.z, LEAST_COSINE)));
}

// Facets with a normal, per area and solid angle.
INLINED float facet_density(const float alpha, const float3 facet)
{
    const float squared = alpha * alpha;
    // 1 - z^2 would have no bits left for the facets of a nearly smooth surface.
    const float spread = facet.x * facet.x + facet.y * facet.y + squared * facet.z * facet.z;
    return squared / (PI * spread * spread);
}

// The light that is scattered from to_light to to_eye, times the cosine of to_light; *density becomes that with which
// sample_bsdf finds to_light. Both are 0 below the surface, and for a mirror.
CALLED float3 evaluate_bsdf(const bsdf_t *bsdf, const float3 to_eye, const float3 to_light, float *density)
{
    *density = 0.0f;
    if (!(to_light.z > LEAST_COSINE && to_eye.z > LEAST_COSINE)) {
        return (float3)(0.0f);
    }
    if (bsdf->is_matte) {
        *density = to_light.z / PI;
        return *density * bsdf->base_colour;
    }
    const float kept = (1.0f - bsdf->metallic) * (1.0f - bsdf->transmission) * (1.0f - bsdf->eye_reflectance);
    float3 scattered = kept * to_light.z / PI * bsdf->base_colour;
    *density = bsdf->diffuse_share * to_light.z / PI;
    if (!is_mirror(bsdf)) {
        const float3 facet = short_unit_vector(to_eye + to_light);
        const float facets = facet_density(bsdf->alpha, facet);
        const float of_eye = hidden_facets(bsdf->alpha, to_eye);
        const float of_light = hidden_facets(bsdf->alpha, to_light);
        const float3 reflectance = find_reflectance(bsdf, limit_share(dot_product(to_eye, facet)));
        scattered += reflectance * (facets / (4.0f * to_eye.z * (1.0f + of_eye + of_light)));
        *density += bsdf->specular_share * facets / (4.0f * to_eye.z * (1.0f + of_eye));
    }
    return scattered;
}

INLINED float3 mirror_direction(const float3 to_eye, const float3 facet)
{
    return 2.0f * dot_product(to_eye, facet) * facet - to_eye;
}

// Draws a direction, in proportion to the scattered light as far as possible. Returns whether there is one.
INLINED bool sample_bsdf(
    const bsdf_t *bsdf, const float3 to_eye, const float lobe, const float2 sample, scattered_t *scattered)
{
    scattered->density = 0.0f;
    scattered->is_below = false;
    if (!(to_eye.z > LEAST_COSINE)) {
        return false;
    }
    if (bsdf->is_matte) {
        scattered->direction = sample_hemisphere(sample);
        scattered->weight = bsdf->base_colour;
        scattered->density = scattered->direction.z / PI;
        return scattered->direction.z > LEAST_COSINE;
    }
    if (lobe < bsdf->diffuse_share) {
        scattered->direction = sample_hemisphere(sample);
    } else {
        const float3 facet =
            is_mirror(bsdf) ? (float3)(0.0f, 0.0f, 1.0f) : sample_facet(bsdf->alpha, to_eye, sample);
        const float cosine = limit_share(dot_product(to_eye, facet));
        if (lobe < bsdf->diffuse_share + bsdf->specular_share) {
            scattered->direction = mirror_direction(to_eye, facet);
            if (is_mirror(bsdf)) {
                scattered->weight = find_reflectance(bsdf, cosine) / bsdf->specular_share;
                return true;
            }
        } else {
            const float refracted_squared = 1.0f - (1.0f - cosine * cosine) / (bsdf->ior_ratio * bsdf->ior_ratio);
            if (!(refracted_squared > 0.0f)) {
                return false;
            }
            const float3 direction = (cosine / bsdf->ior_ratio - square_root(refracted_squared)) * facet
                - to_eye / bsdf->ior_ratio;
            const float through_share = 1.0f - bsdf->diffuse_share - bsdf->specular_share;
            if (!(bsdf->transmission > 0.0f && through_share > 0.0f)) {
                // The shares of an opaque surface add up to a little less than 1 by rounding.
                return false;
            }
            const float kept = (1.0f - bsdf->metallic) * bsdf->transmission
                * (1.0f - dielectric_reflectance(cosine, bsdf->ior_ratio));
            float seen = 1.0f;
            if (!is_mirror(bsdf)) {
                const float of_eye = hidden_facets(bsdf->alpha, to_eye);
                seen = (1.0f + of_eye) / (1.0f + of_eye + hidden_facets(bsdf->alpha, direction));
            }
            scattered->direction = direction;
            scattered->weight = kept * seen / through_share * bsdf->base_colour;
            scattered->is_below = true;
            return direction.z < -LEAST_COSINE;
        }
    }
    const float3 light = evaluate_bsdf(bsdf, to_eye, scattered->direction, &scattered->density);
    scattered->weight = light / scattered->density;
    return scattered->density > 0.0f;
}
