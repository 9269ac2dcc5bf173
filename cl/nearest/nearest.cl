// The triangle that is nearest to a point, in the layout that the host asks for. Each file that this one includes
// defines `visit_nearest`, which hands every triangle that may be nearest to a search.

#include "traverse.cl"

// What several of them need comes first, see traverse.cl.
#include "nearest_search.cl"
#if LAYOUT == LAYOUT_BVH2 || LAYOUT == LAYOUT_BRUTE
#include "nearest_one.cl"
#endif

#if LAYOUT == LAYOUT_BVH2
#include "nearest_bvh2.cl"
#elif LAYOUT == LAYOUT_BRUTE
#include "nearest_brute.cl"
#elif LAYOUT == LAYOUT_BVH4 || LAYOUT == LAYOUT_BVH8
#include "nearest_wide.cl"
#else
#error "LAYOUT must be one of the LAYOUT_ constants"
#endif
