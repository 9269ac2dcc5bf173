// meets_aabb: ray i against box i.
//
// rays[count]                          t_max is the limit that a traversal would pass
// boxes[count]                         six floats: aabb_min, aabb_max
// is_met[count], entries[count]        written; 1 or 0, and where the ray enters

#include "aabb.cl"

kernel void meet_boxes(
    const global ray_t *restrict rays, const global float *restrict boxes, global int *restrict is_met,
    global float *restrict entries, const int count)
{
    const int i = get_global_id(0);
    if (i >= count) {
        return;
    }
    const path_t path = load_path(rays + i);
    float entry;
    is_met[i] = meets_aabb(vload3(2 * i, boxes), vload3(2 * i + 1, boxes), &path, path.t_max, &entry);
    entries[i] = entry;
}
