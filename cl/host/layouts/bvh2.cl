// The nodes of the layout `bvh2`, by clbvh/layouts/device_arrays.py.

#include "structs.cl"

static void store_child(bvh2_node_t *target, const int side, const row_node_t *child, const int first)
{
    for (int axis = 0; axis < 3; axis++) {
        target->aabb_min[side][axis] = child->aabb_min[axis];
        target->aabb_max[side][axis] = child->aabb_max[axis];
    }
    target->first[side] = first;
    target->count[side] = child->count;
}

// Writes one bvh2 node for each interior node, in their order.
//
// numbers             written: those of the interior nodes
loop void pair_children(
    const long count, const row_node_t nodes[count], int numbers[count], const long bvh2_count,
    bvh2_node_t bvh2_nodes[bvh2_count])
{
    if (count == 1) {
        // A missing child has an inverted box, from the greatest number to the least, which no ray hits.
        const row_node_t missing = {
            {FLT_MAX, FLT_MAX, FLT_MAX}, nodes->first, {-FLT_MAX, -FLT_MAX, -FLT_MAX}, nodes->count};
        store_child(bvh2_nodes, 0, nodes, nodes->first);
        store_child(bvh2_nodes, 1, &missing, nodes->first);
        return;
    }
    int interior_count = 0;
    for (long node = 0; node < count; node++) {
        numbers[node] = interior_count;
        interior_count += nodes[node].count == 0;
    }
    bvh2_node_t *target = bvh2_nodes;
    for (long node = 0; node < count; node++) {
        if (nodes[node].count > 0) {
            continue;
        }
        for (int side = 0; side < 2; side++) {
            const int place = nodes[node].first + side;
            store_child(target, side, &nodes[place], nodes[place].count > 0 ? nodes[place].first : numbers[place]);
        }
        target++;
    }
}
