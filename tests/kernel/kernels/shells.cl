// The shells that need no lanes, in one program: a test compiles all of them at once.

#include "kernels/cross_triangles.cl"
#include "kernels/derive_ray.cl"
#include "kernels/keep_crossing.cl"
#include "kernels/meet_boxes.cl"
#include "kernels/order_pairs.cl"
#include "kernels/round_off.cl"
#include "kernels/subtract_products.cl"
#include "kernels/find_surfaces.cl"
#include "kernels/measure_triangles.cl"
#include "kernels/shade_points.cl"
#include "kernels/take_camera_rays.cl"
#include "kernels/take_pixels.cl"
