// The shells for spheres, in one program: a test compiles all of them at once.

// keep: a bundle; the others need single spheres
#include "kernels/trace_spheres.cl"
#if !defined(WIDTH)
#include "kernels/cross_spheres.cl"
#include "kernels/shade_spheres.cl"
#endif
