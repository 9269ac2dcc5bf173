// The shells of looks/ and of the samples of films, in one program: a test compiles all of them at once.

#include "kernels/decode_normals.cl"
#include "kernels/read_textures.cl"
#include "kernels/draw_screen_samples.cl"
