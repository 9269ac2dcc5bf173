// How far a point on the surfaces of a scene is lifted, so that rays above do not meet the primitives that they leave.
//
// docs/internals/offsets.md derives the distance for a triangle that is known. Here it is not, so the distance is that
// for any triangle and any sphere of the instances around the point.

#include "instances/containing.cl"
#include "instances/surface.cl"
#include "points/point.cl"

// Roundings of float32 between a point and the t of a primitive, and on the way into an instance, by that page: 40 and
// 16, and room for the rounding of the corners, of a sphere's radius and of the normal that the user gives.
#define SURFACE_ROUNDINGS 64.0f
#define ENTRY_ROUNDINGS 16.0f

// Float32 cannot tell the sides of an object whose points would need more; no distance would do.
#define MOST_GROWTH 0.5f

// The distance for the primitives of one instance, along a unit normal, both in the scene's local coordinates.
INLINED float lift_over_instance(
    const global instance_t *instance, const point_pair_t *point, const float3 normal)
{
    const float3 way = way_to_instance(instance, point);
    const float3 size = magnitude(transform_vector(instance->to_object, -way));
    const float reach = larger(size.x, larger(size.y, size.z));
    if (reach > 1.0f + ERROR_BOUND(64)) {
        return 0.0f;
    }
    // Normals are transformed to the object by the transpose of the map from there. A height of 1 in the scene is one
    // of 1 / gain in the object.
    const float3 turned = normal.x * load3(instance->to_world[0]) + normal.y * load3(instance->to_world[1])
        + normal.z * load3(instance->to_world[2]);
    const float3 object_normal = unit_vector(turned);
    const float gain = dot_product(turned, object_normal);
    // From inside of a solid, errors along the tangent plane lead out of it, too.
    const float3 weights = IS_TRIANGLES(instance->kind) ? magnitude(object_normal) : (float3)(1.0f);
    const float3 entry =
        transform_bound(instance->to_object, transform_bound(instance->to_world, (float3)(1.0f)));
    const float roundings = ROUNDING * dot_product(weights, SURFACE_ROUNDINGS + ENTRY_ROUNDINGS * entry);
    // The way along the scene's normal leads sideways in the object, and the reach grows.
    const float3 sideways = gain * magnitude(transform_vector(instance->to_object, normal));
    const float growth = roundings * larger(sideways.x, larger(sideways.y, sideways.z));
    return gain * roundings * (1.0f + reach) / (1.0f - smaller(growth, MOST_GROWTH));
}

// The largest of the distances for the visible instances around a point.
INLINED float lift_over_instances(const world_t *world, const point_pair_t *point, const float3 normal)
{
    float lift = 0.0f;
    instance_walk_t walk;
    begin_walk(&walk, world->top_nodes, point->position);
    for (int index = next_containing(&walk, world->top_nodes, point->position); index >= 0;
         index = next_containing(&walk, world->top_nodes, point->position)) {
        if (is_visible(point, world->instances + index)) {
            lift = larger(lift, lift_over_instance(world->instances + index, point, normal));
        }
    }
    return lift;
}
