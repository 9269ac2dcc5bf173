// The instances whose boxes in the tree over them contain a position, one after the other.
//
// Arguments that the kernels share: see instances/traverse.cl. Assumes TOP_STACK_SIZE as there.

#include "structs.cl"
#include "math/numeric.cl"

// Where a walk through the tree is. The children on the stack contain the position.
typedef struct {
    int stack[TOP_STACK_SIZE + 1];  // 2 * node + child
    int stack_count;
    int index;                      // the next instance of a leaf
    int end;
} instance_walk_t;

// Rounding a position to float32 moves it by less than boxes are grown.
INLINED void push_containing(
    instance_walk_t *walk, const global bvh2_node_t *top_nodes, const int node, const float3 position)
{
    for (int child = 0; child < 2; child++) {
        const float3 lower = load3(top_nodes[node].aabb_min[child]);
        const float3 upper = load3(top_nodes[node].aabb_max[child]);
        if (all(lower <= position) && all(position <= upper)) {
            walk->stack[walk->stack_count++] = 2 * node + child;
        }
    }
}

INLINED void begin_walk(instance_walk_t *walk, const global bvh2_node_t *top_nodes, const float3 position)
{
    walk->stack_count = 0;
    walk->index = 0;
    walk->end = 0;
    push_containing(walk, top_nodes, 0, position);
}

// Returns the index of the next instance, or -1 after the last one.
INLINED int next_containing(instance_walk_t *walk, const global bvh2_node_t *top_nodes, const float3 position)
{
    while (walk->index == walk->end) {
        if (walk->stack_count == 0) {
            return -1;
        }
        const int slot = walk->stack[--walk->stack_count];
        const int first = top_nodes[slot >> 1].first[slot & 1];
        const int count = top_nodes[slot >> 1].count[slot & 1];
        if (count > 0) {
            walk->index = first;
            walk->end = first + count;
        } else {
            push_containing(walk, top_nodes, first, position);
        }
    }
    return walk->index++;
}
