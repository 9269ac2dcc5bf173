// How far apart two boxes that lie along surfaces are, for cl/host/clearance/walk.cl.

#include "math/doubles.cl"

#pragma OPENCL EXTENSION cl_khr_fp64 : enable

// Local coordinates are up to 1 and boxes are rounded to float32, their axes too. Corners are placed by sums of three
// products and an offset in float64, and so are boxes.
#define ROOM_OF_BOXES 0x1p-20
#define ROOM_OF_PLACES 0x1p-48
#define SHRINK_OF_BOXES (1.0 - 0x1p-18)

// Transforms are similarities if columns are that equal in length and that much at right angles.
#define SIMILAR 0x1p-40

// A box around the triangles of a node, in local coordinates: see `fit_boxes` of clbvh/trace/clearance/boxes.py.
typedef struct {
    float centre[3];
    float half_sides[3];
    float axes[3][3];
} surface_box_t;

// How an instance maps its local coordinates to the world, in the unit of a search.
//
// rows                of the matrix
// stretch             the length of local axes in the world; not above zero where it is not the same for all, or where
//                     they are not at right angles
typedef struct {
    double3 rows[3];
    double stretch;
} pose_t;

// Two instances.
//
// way                 from the centre of the first one to that of the other one
// room                by which boxes and corners may be off
typedef struct {
    pose_t of[2];
    double3 way;
    double room;
} poses_t;

// Placed in the world: the centre, and half the sides along the axes.
typedef struct {
    double3 centre;
    double3 axes[3];
    double3 half_sides;
} placed_box_t;

INLINED double3 turn(const pose_t *pose, const double3 v)
{
    return (double3)(dot3(pose->rows[0], v), dot3(pose->rows[1], v), dot3(pose->rows[2], v));
}

INLINED double3 widen(const float from[3])
{
    return convert_double3((float3)(from[0], from[1], from[2]));
}

INLINED placed_box_t place_box(const surface_box_t *box, const pose_t *pose)
{
    return (placed_box_t){
        turn(pose, widen(box->centre)),
        {turn(pose, widen(box->axes[0])), turn(pose, widen(box->axes[1])), turn(pose, widen(box->axes[2]))},
        widen(box->half_sides),
    };
}

// Half the sum of a box's sides.
INLINED float size_of_box(const surface_box_t *box)
{
    return box->half_sides[0] + box->half_sides[1] + box->half_sides[2];
}

// How far a box reaches along an axis from its centre.
INLINED double reach_along(const double3 axis, const placed_box_t *box)
{
    return fabs(dot3(axis, box->axes[0])) * box->half_sides.x + fabs(dot3(axis, box->axes[1])) * box->half_sides.y +
           fabs(dot3(axis, box->axes[2])) * box->half_sides.z;
}

// The sum of the squared gaps along the axes of one of two boxes.
INLINED double gaps_along(
    const placed_box_t *own, const placed_box_t *other, const double stretch, const double3 way, const double room)
{
    double squared = 0.0;
    for (int row = 0; row < 3; row++) {
        double gap;
        if (stretch > 0.0) {
            const double reach = reach_along(own->axes[row], other);
            gap = (fabs(dot3(own->axes[row], way)) - reach) / stretch - own->half_sides[row] * stretch;
        } else {
            double3 axis = (double3)(0.0);
            axis[row] = 1.0;
            gap = fabs(way[row]) - reach_along(axis, other) - reach_along(axis, own);
        }
        gap = most_of(gap - room, 0.0);
        squared += gap * gap;
    }
    return squared;
}

// At most the squared distance of what is in two boxes, and the squared distance of their centres.
//
// They are apart by at least the gaps along three axes at right angles: those of either box, or of the world where a
// transform has bent the box.
static double2 bound_distance(const surface_box_t *a, const surface_box_t *b, const poses_t *poses)
{
    const placed_box_t one = place_box(a, &poses->of[0]);
    const placed_box_t other = place_box(b, &poses->of[1]);
    const double3 way = other.centre - one.centre + poses->way;
    const double squared = most_of(
        gaps_along(&one, &other, poses->of[0].stretch, way, poses->room),
        gaps_along(&other, &one, poses->of[1].stretch, way, poses->room));
    return (double2)(squared * SHRINK_OF_BOXES, dot3(way, way));
}
