// Locations and normals of hits, for clbvh/trace/hits/surface.py.
//
// arrays              `SurfaceArrays.addresses`
// prim_ids[count], instance_ids[count], us[count], vs[count]    points on primitives; NO_PRIM for none, which get NaN

#include "structs.cl"
#include "hits/found.cl"
#include "hits/locations.cl"
#include "hits/surfaces.cl"

// Writes where the points are, in world coordinates.
loop void locate_points(
    const ulong *arrays, const long count, const int prim_ids[count], const int instance_ids[count],
    const double us[count], const double vs[count], double locations[count][3])
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    for (long hit = 0; hit < count; hit++) {
        const bool is_hit = prim_ids[hit] != NO_PRIM;
        vstore3(
            is_hit ? locate_point(&surfaces, instance_ids[hit], prim_ids[hit], us[hit], vs[hit]) : (double3)(NAN), 0,
            locations[hit]);
    }
}

// Writes unit normals in the world, on the object's outer side.
loop void find_normals(
    const ulong *arrays, const long count, const int prim_ids[count], const int instance_ids[count],
    const double us[count], const double vs[count], double normals[count][3])
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    for (long hit = 0; hit < count; hit++) {
        const bool is_hit = prim_ids[hit] != NO_PRIM;
        vstore3(
            is_hit ? normal_at_point(&surfaces, instance_ids[hit], prim_ids[hit], us[hit], vs[hit]) : (double3)(NAN), 0,
            normals[hit]);
    }
}

// Writes whether directions of any length lead to the object's outer side, or along the primitive.
loop void find_sides(
    const ulong *arrays, const long count, const int prim_ids[count], const int instance_ids[count],
    const double us[count], const double vs[count], const double directions[count][3], bool is_front[count])
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    for (long hit = 0; hit < count; hit++) {
        const double3 direction = load_wide_row(directions[hit], 0);
        // The products of a tiny direction would underflow.
        is_front[hit] = prim_ids[hit] != NO_PRIM
            && dot3(
                   direction / largest_size(direction),
                   normal_at_point(&surfaces, instance_ids[hit], prim_ids[hit], us[hit], vs[hit]))
                >= 0.0;
    }
}

// Writes unit normals in the world of vectors that are normal in objects; NaN without an instance.
loop void turn_normals(
    const ulong *arrays, const long count, const int instance_ids[count], const double object_normals[count][3],
    double normals[count][3])
{
    const surfaces_t surfaces = surfaces_on_host(arrays);
    for (long hit = 0; hit < count; hit++) {
        const double3 normal = load_wide_row(object_normals[hit], 0);
        const bool is_hit = instance_ids[hit] != NO_PRIM;
        vstore3(is_hit ? turn_normal(&surfaces, instance_ids[hit], normal).unit : (double3)(NAN), 0, normals[hit]);
    }
}
