// Picks the layout that the host asks for. Each defines
//
// node_t, group_t    what `nodes` and `groups` hold; a group is the triangles that are tested together
// traverse           report each crossing of a ray to a search, until that is settled; it begins at the node `start`
// HAS_ENTRIES        whether that may be another one than the root, see entry.cl
// corners_at         the corners of the triangle at a crossing's place

// What several of them need comes first: the host expands each include once, where it first stands, and that must
// not be inside a branch that is left out.
#include "aabb.cl"
#include "search.cl"
#include "triangle.cl"
#if LAYOUT == LAYOUT_BVH2 || LAYOUT == LAYOUT_BRUTE
#include "one_triangle.cl"
#elif LAYOUT == LAYOUT_BVH4
#define WIDTH 4
typedef bvh4_node_t node_t;
typedef group4_t group_t;
#elif LAYOUT == LAYOUT_BVH8
#define WIDTH 8
typedef bvh8_node_t node_t;
typedef group8_t group_t;
#endif

// Two children would be too few to begin with.
#define HAS_ENTRIES (LAYOUT == LAYOUT_BVH4 || LAYOUT == LAYOUT_BVH8)

#if LAYOUT == LAYOUT_BVH2
#include "traverse_bvh2.cl"
#elif LAYOUT == LAYOUT_BRUTE
#include "traverse_brute.cl"
#elif LAYOUT == LAYOUT_BVH4 || LAYOUT == LAYOUT_BVH8
#include "traverse_wide.cl"
#else
#error "LAYOUT must be one of the LAYOUT_ constants"
#endif
