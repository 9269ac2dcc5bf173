// The shells for placed geometries, in one program: a test compiles all of them at once.

#include "kernels/measure_ellipsoids.cl"
#include "kernels/measure_placed.cl"
