// Trees on the device, by refit.py and top_tree.py of clbvh/trace/world.

#include "boxes/row.cl"

// Writes how far the farthest leaf is below each node; children stand behind their parent.
//
// children            of each node `width` nodes, with 0 in place of leaves and missing ones
loop void find_levels(const long count, long levels[count], const int width, const int children[count * width])
{
    for (long node = count - 1; node >= 0; node--) {
        long level = 0;
        for (int slot = 0; slot < width; slot++) {
            const int child = children[node * width + slot];
            level = child > 0 ? max(level, levels[child] + 1) : level;
        }
        levels[node] = level;
    }
}

// Writes the nodes over the primitives that are left, children behind their parents; returns their number.
//
// left_before         how many primitives are left before each one in the order of the leaves, and in all
// has_any             scratch: whether there is one below a node
// sources             scratch: the node that each one is written from
loop int prune(
    const long count, const row_node_t nodes[count], const int *left_before, bool has_any[count], const long room,
    int sources[room], row_node_t pruned[room])
{
    for (long node = count - 1; node >= 0; node--) {
        const int first = nodes[node].first;
        has_any[node] = nodes[node].count > 0 ? left_before[first + nodes[node].count] > left_before[first]
                                              : has_any[first] || has_any[first + 1];
    }

    int end = 1;
    sources[0] = 0;
    for (int target = 0; target < end; target++) {
        // A node one of whose children is empty is nothing but the other one.
        const row_node_t *node = nodes + sources[target];
        while (node->count == 0 && !(has_any[node->first] && has_any[node->first + 1])) {
            node = nodes + node->first + (has_any[node->first] ? 0 : 1);
        }
        const int first = node->first;
        const int count = node->count;
        pruned[target] = *node;
        if (count > 0) {
            pruned[target].first = left_before[first];
            pruned[target].count = left_before[first + count] - left_before[first];
        } else {
            pruned[target].first = end;
            sources[end++] = first;
            sources[end++] = first + 1;
        }
    }

    for (int node = end - 1; node >= 0; node--) {
        const int first = pruned[node].first;
        if (pruned[node].count == 0) {
            const float8 box = unite(row_of_node(&pruned[first]), row_of_node(&pruned[first + 1]));
            store_node(&pruned[node], box, first, 0);
        }
    }
    return end;
}
