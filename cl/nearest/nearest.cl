// The primitive nearest to a point, in the layout that the host asks for by LAYOUT. Each layout defines `find_nearest`,
// which tests every primitive that may be the nearest.

// keep: defines node_t, block_t and WIDTH of the layout, and expands what several layouts include
#include "traversal/traverse.cl"

// keep: the find_nearest of one layout
#if LAYOUT == LAYOUT_BVH2
#include "nearest/bvh2.cl"
#elif LAYOUT == LAYOUT_BRUTE
#include "nearest/brute.cl"
#elif HAS_ENTRY_POINTS
#include "nearest/wide.cl"
#else
#error "LAYOUT must be one of the LAYOUT_ constants"
#endif
