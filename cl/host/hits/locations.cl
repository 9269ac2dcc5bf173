// Locations and normals of hits, for clbvh/trace/hits/surface.py.
//
// arrays              `SurfaceArrays.addresses`
// prim_ids[count], instance_ids[count], us[count], vs[count]    points on primitives; NO_PRIM for none, which get NaN

#include "structs.cl"
#include "hits/found.cl"
#include "hits/locations.cl"
#include "hits/surfaces.cl"
#include "spheres/crossing.cl"

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
        double3 normal = (double3)(NAN);
        if (prim_ids[hit] != NO_PRIM) {
            const int geometry = surfaces.geometry_id[instance_ids[hit]];
            if (surfaces.kind[geometry] == KIND_SPHERES) {
                normal = sphere_point(us[hit], vs[hit]);
            } else {
                const wide_corners_t corners = load_wide_corners(&surfaces, geometry, prim_ids[hit]);
                normal = normal_of(&corners, surfaces.scale[geometry]);
            }
            normal = turn_normal(&surfaces, instance_ids[hit], normal).unit;
        }
        vstore3(normal, 0, normals[hit]);
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
