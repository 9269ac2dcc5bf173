// The kernels that cast rays, in one program: a test compiles all of them at once.

#include "kernels/any_hit.cl"
#include "kernels/closest_hit.cl"
#include "kernels/count_hits.cl"
#include "kernels/first_hits.cl"
#include "kernels/tile_entry_points.cl"
