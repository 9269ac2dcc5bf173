// Picks the traversal that the host asks for. Each defines `traverse` with the same arguments.

// What several of them need comes first: the host expands each include once, where it first stands, and that must
// not be inside a branch that is left out.
#include "aabb.cl"
#include "crossing.cl"
#include "triangle.cl"

#if LAYOUT == LAYOUT_BVH2
#include "traverse_bvh2.cl"
#elif LAYOUT == LAYOUT_BRUTE
#include "traverse_brute.cl"
#else
#error "LAYOUT must be one of the LAYOUT_ constants"
#endif
