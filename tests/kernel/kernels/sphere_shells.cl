// The shells for spheres, in one program: a test compiles all of them at once.

#include "kernels/trace_spheres.cl"
#if !defined(WIDTH)
#include "kernels/cross_spheres.cl"
#endif
