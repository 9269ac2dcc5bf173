// The shells that work in lanes, in one program: a test compiles all of them at once.

#include "kernels/bound_camera.cl"
#include "kernels/meet_children.cl"
#include "kernels/meet_by_beam.cl"
#include "kernels/measure_lanes.cl"
#include "kernels/pack_lanes.cl"
