// Traversal in the layout that the host asks for by LAYOUT. Each layout defines
//
// node_t, block_t     element types of `nodes` and `blocks`; a block is the primitives that are tested together
// traverse            reports each crossing of a ray to a search, until that is complete, from the node `start` down
// corners_at          corners of a triangle, by its index
//
// Assumes LAYOUT, one of the LAYOUT_ constants, and STACK_SIZE, see the layouts. The blocks of a tree over other
// primitives than triangles are passed as if they were block_t, see cl/prims.

#include "structs.cl"
#if LAYOUT == LAYOUT_BVH4
#define WIDTH 4
typedef bvh4_node_t node_t;
typedef triangle4_t block_t;
#elif LAYOUT == LAYOUT_BVH8
#define WIDTH 8
typedef bvh8_node_t node_t;
typedef triangle8_t block_t;
#elif LAYOUT == LAYOUT_BVH8C
#define WIDTH 8
#define HAS_SHARED_VERTICES 1
typedef bvh8_node_t node_t;
typedef shared_unit_t block_t;
#endif

// keep: files that several layouts include are expanded before the branches. The host expands each file once, where it
// is first included, and that must not be inside a branch that is left out
#include "boxes/aabb.cl"
#include "boxes/padding.cl"
#include "hits/search.cl"
#include "spheres/distance.cl"
#include "spheres/sphere.cl"
#include "triangles/triangle.cl"
#if LAYOUT == LAYOUT_BVH2 || LAYOUT == LAYOUT_BRUTE
#include "prims/single.cl"
#endif

// Whether rays may begin at an entry point, see traversal/entry_point.cl; two children are too few for one.
#define HAS_ENTRY_POINTS (LAYOUT == LAYOUT_BVH4 || LAYOUT == LAYOUT_BVH8 || LAYOUT == LAYOUT_BVH8C)

// keep: the traversal of one layout
#if LAYOUT == LAYOUT_BVH2
#include "traversal/bvh2.cl"
#elif LAYOUT == LAYOUT_BRUTE
#include "traversal/brute.cl"
#elif HAS_ENTRY_POINTS
#include "traversal/wide.cl"
#else
#error "LAYOUT must be one of the LAYOUT_ constants"
#endif
