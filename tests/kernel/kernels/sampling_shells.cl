// The shells of sampling/ and math/trigonometry.cl, in one program: a test compiles all of them at once.

#include "kernels/derive_angles.cl"
#include "kernels/draw_samples.cl"
#include "kernels/warp_samples.cl"
#include "kernels/frame_normals.cl"
