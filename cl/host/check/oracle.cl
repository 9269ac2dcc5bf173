// The oracle of clbvh/trace/check: every ray against every primitive, in float64, and what it says of answers. It
// includes no other file: it is worth something because it shares no code with the device.

// The rays of a world are advanced to within this many times `Tolerance.near` radii of it; beyond, t does not grow.
#define ADVANCED 2.0

// A component of a normal is a difference of two products, each of two edges: float64 rounds it by this share of the
// square of the largest edge at most.
#define NORMAL_ROUNDING 0x1p-50

#define NO_ID -1

// The numbers of an instance and of `Tolerance`, and the radius of the world: `_VIEW` of instances.py.
typedef struct {
    long instance_id;
    long geometry_id;
    long mask;
    double unit;
    double centre[3];
    double radius;
    double growth;
    double local_growth;
    double entering;
    double pair;
    double near;
    double order;
    double world_radius;
} view_t;

// An intersection, see `Intersections`: `INTERSECTION` of intersections.py.
typedef struct {
    long ray;
    long instance_id;
    long geometry_id;
    long prim_id;
    double t;
    double t_low;
    double t_high;
    double t_slack;
    long side;
    long is_sure;
    long twin_instance;
    long twin_prim;
} intersection_t;

static double dot_of(const double3 a, const double3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static double length_of(const double3 v)
{
    return sqrt(dot_of(v, v));
}

static double3 cross_of(const double3 a, const double3 b)
{
    return a.yzx * b.zxy - a.zxy * b.yzx;
}

// How far the device may see a ray from where it is, in units and in local units.
//
// distance            of the ray's origin from the centre, in units
static double2 blur_of(const view_t *view, const double distance)
{
    const double reach = view->radius + min(distance, view->near * view->radius);
    const double rounded = view->pair * (distance + view->world_radius / view->unit);
    const double entering = view->entering * reach;
    return (double2)(view->growth * entering + rounded, view->local_growth * (entering + rounded));
}

// Writes the blur in units for rays from some distances.
loop void find_blurs(const double view[15], const long count, const double distances[count], double blurs[count])
{
    for (long index = 0; index < count; index++) {
        blurs[index] = blur_of((const view_t *)view, distances[index]).x;
    }
}

// Writes the rays that may meet an instance, see `_SeenRays`; returns how many there are. The directions are 1 long.
loop long see_rays(
    const double view_numbers[15], const long count, const double origins[count][3], const double directions[count][3],
    const uint masks[count], long ids[count], double feet[count][3], double seen_directions[count][3],
    double shifts[count], double blurs[count], double local_blurs[count])
{
    const view_t *view = (const view_t *)view_numbers;
    long seen_count = 0;
    for (long ray = 0; ray < count; ray++) {
        if ((masks[ray] & view->mask) == 0) {
            continue;
        }
        const double3 direction = vload3(0, directions[ray]);
        const double3 origin = (vload3(0, origins[ray]) - vload3(0, view->centre)) / view->unit;
        // The foot of a far origin is rounded, and so it moves once more.
        const double shift = -dot_of(origin, direction);
        const double3 near = origin + shift * direction;
        const double more = -dot_of(near, direction);
        const double3 foot = near + more * direction;
        const double2 blur = blur_of(view, length_of(origin));
        if (!(length_of(foot) <= view->radius + blur.x)) {
            continue;
        }
        ids[seen_count] = ray;
        vstore3(foot, seen_count, feet[0]);
        vstore3(direction, seen_count, seen_directions[0]);
        shifts[seen_count] = shift + more;
        blurs[seen_count] = blur.x;
        local_blurs[seen_count] = blur.y;
        seen_count++;
    }
    return seen_count;
}

// Rays with their limits, and where intersections go.
//
// room                that there is room for
// count               that there are
typedef struct {
    const view_t *view;
    const double *t_mins;
    const double *t_maxs;
    const double *lengths;
    intersection_t *found;
    long room;
    long count;
} search_t;

// Along a ray in units: a distance, and the least and the greatest that the device may find.
typedef struct {
    double distance;
    double low;
    double high;
    bool is_sure;
} meeting_t;

// Adds an intersection that the limits of the ray allow.
static void add_intersection(
    search_t *search, const long ray, const long prim, const int side, const meeting_t meeting)
{
    const view_t *view = search->view;
    const double length = search->lengths[ray];
    const double scale = view->unit / length;
    const double t = meeting.distance * scale;
    const double low = meeting.low * scale;
    const double high = meeting.high * scale;
    const double slack =
        min(view->order * fabs(t), view->order * ADVANCED * view->near * view->world_radius / length);
    if (!(high + slack >= search->t_mins[ray] && low - slack <= search->t_maxs[ray])) {
        return;
    }
    const bool is_sure = meeting.is_sure && low - slack > search->t_mins[ray] && high + slack < search->t_maxs[ray];
    if (search->count < search->room) {
        search->found[search->count] = (intersection_t){
            ray, view->instance_id, view->geometry_id, prim, t, low, high, slack, side, is_sure, NO_ID, NO_ID,
        };
    }
    search->count++;
}

// Orthonormal axes, the last of which is a ray's direction.
typedef struct {
    double3 x;
    double3 y;
    double3 z;
} frame_t;

static frame_t make_frame(const double3 direction)
{
    const double3 along = direction / length_of(direction);
    // Any axis that is far from parallel to the ray gives a stable first cross product.
    const double3 size = fabs(along);
    const int axis = size.y < size.x ? (size.z < size.y ? 2 : 1) : (size.z < size.x ? 2 : 0);
    double3 helper = (double3)(0.0);
    helper[axis] = 1.0;
    const double3 across = cross_of(helper, along);
    const double3 x = across / length_of(across);
    return (frame_t){x, cross_of(along, x), along};
}

// A corner's coordinates in the frame: two across the ray, one along it.
static double3 project(const frame_t *frame, const double3 corner)
{
    return (double3)(dot_of(corner, frame->x), dot_of(corner, frame->y), dot_of(corner, frame->z));
}

static double least_of(const double a, const double b, const double c)
{
    return min(min(a, b), c);
}

static double most_of(const double a, const double b, const double c)
{
    return max(max(a, b), c);
}

// The distance of zero from the segment between two points.
static double distance_to_segment(const double2 a, const double2 b)
{
    const double2 way = b - a;
    const double square = way.x * way.x + way.y * way.y;
    const double share = square > 0.0 ? min(max(-(a.x * way.x + a.y * way.y) / square, 0.0), 1.0) : 0.0;
    const double2 nearest = a + share * way;
    return sqrt(nearest.x * nearest.x + nearest.y * nearest.y);
}

// Tests one triangle, given in the ray's frame, against the ray along the z axis from zero. Returns whether it may be
// met.
//
// blur                how far the device may see each corner from where it is, across the ray and along it
//
// While the corners move by up to the blur, a ray that is farther than that from all edges stays on its side of them. A
// point of the moved triangle has moved by no more than the blur either. So a hit is at the height of a point of the
// exact triangle that is as near to the ray, give or take the blur. Both hold for slivers thinner than the blur.
static bool meet_triangle(const double3 a, const double3 b, const double3 c, const double blur, meeting_t *meeting)
{
    if (least_of(a.x, b.x, c.x) > blur || most_of(a.x, b.x, c.x) < -blur || least_of(a.y, b.y, c.y) > blur ||
        most_of(a.y, b.y, c.y) < -blur) {
        return false;
    }

    // On which side of the edges does the ray pass, and how far from them?
    const double3 sides = (double3)(b.x * c.y - b.y * c.x, c.x * a.y - c.y * a.x, a.x * b.y - a.y * b.x);
    const bool is_beside = (sides.x < 0.0 || sides.y < 0.0 || sides.z < 0.0) &&
                           (sides.x > 0.0 || sides.y > 0.0 || sides.z > 0.0);
    const double nearest = least_of(
        distance_to_segment(b.xy, c.xy), distance_to_segment(c.xy, a.xy), distance_to_segment(a.xy, b.xy));
    if (is_beside && nearest > blur) {
        return false;
    }
    meeting->is_sure = nearest > blur;

    // Where does it cross the plane? A triangle that is seen edge-on is crossed anywhere between its corners.
    const double3 normal = cross_of(b - a, c - a);
    const double low = least_of(a.z, b.z, c.z);
    const double high = most_of(a.z, b.z, c.z);
    if (normal.z == 0.0) {
        meeting->distance = (low + high) / 2.0;
        meeting->low = low - blur;
        meeting->high = high + blur;
        return true;
    }
    // A shift along the ray, and one across it, which a slanted plane turns into one along it.
    const double height = dot_of(normal, a) / normal.z;
    const double slant = length_of(normal) / fabs(normal.z);
    // Of corners that are nearly in one line, float64 itself rounds the normal off.
    const double reach =
        max(max(most_of(fabs(a.x), fabs(a.y), fabs(b.x)), fabs(b.y)), max(fabs(c.x), fabs(c.y))) + (high - low);
    const double rounding = NORMAL_ROUNDING * reach * reach / fabs(normal.z) * (1.0 + slant) * reach;
    const double slack = blur * (1.0 + slant) + rounding;
    meeting->distance = min(max(height, low), high);
    meeting->low = max(height - slack, low - blur);
    meeting->high = min(height + slack, high + blur);
    return true;
}

// Writes the intersections of rays with triangles that there is room for; returns how many there are.
loop long meet_triangles(
    const double view[15], const long ray_count, const double t_mins[ray_count], const double t_maxs[ray_count],
    const double lengths[ray_count], const long seen_count, const long ids[seen_count],
    const double feet[seen_count][3], const double directions[seen_count][3], const double shifts[seen_count],
    const double blurs[seen_count], const long vertex_count, const double vertices[vertex_count][3],
    const long face_count, const int faces[face_count][3], const bool degenerate[face_count], const long room,
    long found[room][12])
{
    search_t search = {(const view_t *)view, t_mins, t_maxs, lengths, (intersection_t *)found, room, 0};
    for (long index = 0; index < seen_count; index++) {
        const frame_t frame = make_frame(vload3(0, directions[index]));
        const double3 foot = vload3(0, feet[index]);
        for (long prim = 0; prim < face_count; prim++) {
            if (degenerate[prim]) {
                continue;
            }
            double3 corners[3];
            for (int corner = 0; corner < 3; corner++) {
                corners[corner] = project(&frame, vload3(0, vertices[faces[prim][corner]]) - foot);
            }
            meeting_t meeting;
            if (meet_triangle(corners[0], corners[1], corners[2], blurs[index], &meeting)) {
                meeting.distance = shifts[index] + meeting.distance;
                meeting.low = shifts[index] + meeting.low;
                meeting.high = shifts[index] + meeting.high;
                add_intersection(&search, ids[index], prim, 0, meeting);
            }
        }
    }
    return search.count;
}

// Half the chord of a circle at a distance from its centre; 0 beside the circle.
static double chord_reach(const double radius, const double distance)
{
    const double beside = max(distance, 0.0);
    return beside < radius ? sqrt((radius - beside) * (radius + beside)) : 0.0;
}

// Writes the intersections of rays with spheres that there is room for; returns how many there are.
//
// feet, directions, blurs   local
// stretches                 the lengths of directions that are 1 long in units
loop long meet_spheres(
    const double view[15], const long ray_count, const double t_mins[ray_count], const double t_maxs[ray_count],
    const double lengths[ray_count], const long seen_count, const long ids[seen_count],
    const double feet[seen_count][3], const double directions[seen_count][3], const double shifts[seen_count],
    const double blurs[seen_count], const double stretches[seen_count], const long sphere_count,
    const double centres[sphere_count][3], const double radii[sphere_count], const long room, long found[room][12])
{
    search_t search = {(const view_t *)view, t_mins, t_maxs, lengths, (intersection_t *)found, room, 0};
    for (long index = 0; index < seen_count; index++) {
        const double3 direction = vload3(0, directions[index]);
        const double shift = shifts[index];
        const double blur = blurs[index];
        for (long prim = 0; prim < sphere_count; prim++) {
            const double radius = radii[prim];
            const double3 way = vload3(0, centres[prim]) - vload3(0, feet[index]);
            const double along = dot_of(way, direction);
            const double beside = length_of(way + -along * direction);
            if (beside > radius + blur) {
                continue;
            }
            // Half the chord, and what the blur can make of it: much, where the ray is almost a tangent.
            const double reach = chord_reach(radius, beside);
            const double reach_low = chord_reach(radius - blur, beside + blur);
            const double reach_high = chord_reach(radius + blur, beside - blur);
            for (int side = -1; side <= 1; side += 2) {
                const double one = along + side * reach_low;
                const double other = along + side * reach_high;
                const meeting_t meeting = {
                    shift + (along + side * reach) / stretches[index],
                    shift + (min(one, other) - blur) / stretches[index],
                    shift + (max(one, other) + blur) / stretches[index],
                    beside < radius - blur,
                };
                add_intersection(&search, ids[index], prim, side, meeting);
            }
        }
    }
    return search.count;
}

// Whether two intersections are those of equal primitives in the same place, at the same t.
static bool are_twins(const intersection_t *one, const intersection_t *other)
{
    return one->twin_instance == other->twin_instance && one->twin_prim == other->twin_prim && one->side == other->side;
}

// By how much the t of two intersections may be off besides, where they are compared.
static double slack_of(const intersection_t *one, const intersection_t *other)
{
    return one->instance_id == other->instance_id ? 0.0 : one->t_slack + other->t_slack;
}

static bool is_surely_before(const intersection_t *one, const intersection_t *other)
{
    return one->t_high + slack_of(one, other) < other->t_low;
}

// Whether a hit may be reported at t for an intersection, whose t is limited to those of the ray.
static bool may_be_at(
    const intersection_t *one, const double t, const double t_min, const double t_max, const double raised)
{
    const double low = min(max(one->t_low, t_min), t_max);
    const double high = min(max(one->t_high, t_min), t_max);
    return low <= t && t <= max(high, raised);
}

// Writes the index of each ray's nearest sure intersection, or -1, and whether no other answer can be right.
//
// offsets             where the intersections of each ray begin, and where those of the last one end
loop void find_closest(
    const long count, const long intersections[count][12], const long ray_count, long first[ray_count],
    bool is_decided[ray_count], const long offsets[ray_count + 1])
{
    const intersection_t *known = (const intersection_t *)intersections;
    for (long ray = 0; ray < ray_count; ray++) {
        const intersection_t *begin = known + offsets[ray];
        const intersection_t *end = known + offsets[ray + 1];
        const intersection_t *nearest = begin;
        while (nearest < end && !nearest->is_sure) {
            nearest++;
        }
        first[ray] = nearest < end ? nearest - known : -1;
        is_decided[ray] = begin == end || nearest < end;
        for (const intersection_t *other = begin; other < end && nearest < end; other++) {
            if (other != nearest && !are_twins(other, nearest)) {
                is_decided[ray] &= other->t_low - slack_of(other, nearest) > nearest->t_high;
            }
        }
    }
}

// Why an answer is wrong: `_REASONS` of reference.py.
#define RIGHT 0
#define MISSED 1
#define NOT_THERE 2
#define BEHIND 3
#define TWIN 4
#define MISS_WITH_T 5

// Whether the ids of an intersection are smaller than others.
static bool has_smaller_ids(const intersection_t *one, const long instance_id, const long prim_id)
{
    return one->instance_id < instance_id || (one->instance_id == instance_id && one->prim_id < prim_id);
}

// Writes why each closest hit is wrong, and the intersection that is meant, if there is one. NaN is wrong.
//
// meant               -1 before
loop void check_hits(
    const long count, const long intersections[count][12], const long ray_count, const double t_mins[ray_count],
    const double t_maxs[ray_count], const double ts[ray_count], const long instance_ids[ray_count],
    const long prim_ids[ray_count], long reasons[ray_count], long meant[ray_count], const long offsets[ray_count + 1])
{
    const intersection_t *known = (const intersection_t *)intersections;
    for (long ray = 0; ray < ray_count; ray++) {
        if (prim_ids[ray] == NO_ID) {
            reasons[ray] = ts[ray] == INFINITY ? RIGHT : MISS_WITH_T;
            for (long index = offsets[ray]; index < offsets[ray + 1]; index++) {
                if (known[index].is_sure) {
                    reasons[ray] = MISSED;
                }
            }
            continue;
        }
        // The intersection that is meant. Of a sphere there are two, so any of them will do.
        reasons[ray] = NOT_THERE;
        for (long index = offsets[ray]; index < offsets[ray + 1] && reasons[ray] != RIGHT; index++) {
            const intersection_t *one = &known[index];
            if (one->instance_id != instance_ids[ray] || one->prim_id != prim_ids[ray] ||
                !may_be_at(one, ts[ray], t_mins[ray], t_maxs[ray], -INFINITY)) {
                continue;
            }
            reasons[ray] = RIGHT;
            meant[ray] = index;
            for (long other = offsets[ray]; other < offsets[ray + 1]; other++) {
                if (known[other].is_sure && is_surely_before(&known[other], one)) {
                    reasons[ray] = BEHIND;
                }
                if (are_twins(&known[other], one) &&
                    has_smaller_ids(&known[other], instance_ids[ray], prim_ids[ray])) {
                    reasons[ray] = TWIN;
                }
            }
        }
    }
}

// Writes which rays' hits cannot be all that there are, or not in this order, and the intersection that each hit means.
//
// first_hits          where the hits of each ray begin, and where those of the last one end
// meant               -1 before
// is_used             of intersections; false before
loop void check_all_hits(
    const long count, const long intersections[count][12], const long ray_count, const double t_mins[ray_count],
    const double t_maxs[ray_count], const long hit_count, const double ts[hit_count],
    const long instance_ids[hit_count], const long prim_ids[hit_count], bool is_wrong[ray_count],
    long meant[hit_count], bool is_used[count], const long offsets[ray_count + 1], const long first_hits[ray_count + 1])
{
    const intersection_t *known = (const intersection_t *)intersections;
    for (long ray = 0; ray < ray_count; ray++) {
        const long begin = offsets[ray];
        const long end = offsets[ray + 1];
        double latest = -INFINITY;
        for (long hit = first_hits[ray]; hit < first_hits[ray + 1]; hit++) {
            // Each hit is one that there can be. Its t may be raised to that of the hit before it.
            for (int is_raised = 0; is_raised < 2; is_raised++) {
                for (long index = begin; index < end && meant[hit] < 0; index++) {
                    const intersection_t *one = &known[index];
                    if (!is_used[index] && one->instance_id == instance_ids[hit] && one->prim_id == prim_ids[hit] &&
                        may_be_at(one, ts[hit], t_mins[ray], t_maxs[ray], is_raised ? latest : -INFINITY)) {
                        is_used[index] = true;
                        meant[hit] = index;
                    }
                }
            }
            if (meant[hit] < 0 || (hit > first_hits[ray] && !(ts[hit] >= ts[hit - 1]))) {
                is_wrong[ray] = true;
                break;
            }
            const intersection_t *one = &known[meant[hit]];
            latest = max(latest, min(max(one->t_high, t_mins[ray]), t_maxs[ray]));

            // None of those before it is surely behind it; and of twins, those with smaller ids come first.
            for (long before = first_hits[ray]; before < hit; before++) {
                const intersection_t *earlier = &known[meant[before]];
                const bool is_first = has_smaller_ids(one, instance_ids[before], prim_ids[before]);
                is_wrong[ray] |= is_surely_before(one, earlier) || (are_twins(one, earlier) && is_first);
            }
        }

        // None that is sure is missing, and no twin of one that is found.
        for (long index = begin; index < end; index++) {
            for (long other = begin; other < end && !is_used[index]; other++) {
                is_wrong[ray] |= is_used[other] && are_twins(&known[index], &known[other]);
            }
            is_wrong[ray] |= !is_used[index] && known[index].is_sure;
        }
    }
}
