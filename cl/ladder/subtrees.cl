// A range of primitives becomes a subtree: of linked nodes, which are flattened later, or flat at once. For
// cl/host/ladder.

#include "ladder/divide.cl"

// From the C library.
void *malloc(size_t size);
void free(void *memory);

// References are addresses of children, less that of the blocks which all workers share: every process has these
// elsewhere. The row `LINKED_NODE` of clbvh/builders/ladder/steps.py.
typedef struct {
    box_row_t box;
    long left;
    long right;
    int first;
    int count;  // 0 in an interior node
} linked_node_t;

// Undivided steps need an aligned number.
typedef long counter_t __attribute__((aligned(8)));

// Where nodes come from: the process's own heap, one `malloc` each, if `blocks` is null; or those blocks, by an atomic
// counter that all workers share.
typedef struct {
    linked_node_t *blocks;
    counter_t *counter;
} heap_t;

INLINED linked_node_t *allocate_node(const heap_t *heap)
{
    if (heap->blocks) {
        return &heap->blocks[__atomic_fetch_add(heap->counter, 1, __ATOMIC_SEQ_CST)];
    }
    (*heap->counter)++;
    return malloc(sizeof(linked_node_t));
}

INLINED linked_node_t *node_of(const linked_node_t *blocks, const long reference)
{
    return (linked_node_t *)((long)blocks + reference);
}

INLINED long reference_to(const linked_node_t *blocks, const linked_node_t *node)
{
    return (long)node - (long)blocks;
}

// Frees a node of the process's own heap, and all below it.
static void free_nodes(linked_node_t *node)
{
    if (node->count == 0) {
        free_nodes(node_of(0, node->left));
        free_nodes(node_of(0, node->right));
    }
    free(node);
}

// A builder at work.
//
// prim_ids            the index array, written by leaves
// scratch             as long as the longest range
typedef struct {
    prims_t prims;
    rule_t rule;
    int *prim_ids;
    int *scratch;
    heap_t heap;
} builder_t;

// Writes the primitives of a leaf in ascending order; both arrays may be the same memory. O(n) for a range that is in
// order already, as the large leaves of the frontier are.
static void list_prims(const builder_t *builder, const int *ids, const long count, int *leaf)
{
    for (long index = 0; index < count; index++) {
        const int prim = ids[index];
        long slot = index;
        for (; slot > 0 && leaf[slot - 1] > prim; slot--) {
            put(&builder->prims, &leaf[slot], leaf[slot - 1]);
        }
        put(&builder->prims, &leaf[slot], prim);
    }
}

// Returns a list of a node's own; null if there is no memory.
static int *copy_list(const builder_t *builder, const int *ids, const long count)
{
    COUNT(&builder->prims, allocations);
    int *list = malloc(count * sizeof(int));
    for (long index = 0; index < count && list; index++) {
        put(&builder->prims, &list[index], ids[index]);
    }
    return list;
}

static linked_node_t *build_child(const builder_t *builder, int *ids, long count, long first, int depth);

// Builds a subtree of linked nodes; returns its root, null if there is no memory.
//
// ids                 the range: in the index array, or a list of the node's own
// first               where it begins in the index array
static linked_node_t *build_linked(
    const builder_t *builder, int *ids, const long count, const long first, const int depth)
{
    COUNT(&builder->prims, allocations);
    linked_node_t *node = allocate_node(&builder->heap);
    if (!node) {
        return 0;
    }
    const bounds_t bounds = bound_range(&builder->prims, ids, count);
    node->box = bounds.box;
    if (count <= builder->rule.leaf_size) {
        node->first = first;
        node->count = count;
        list_prims(builder, ids, count, builder->prim_ids + first);
        return node;
    }
    node->count = 0;
    const long middle = divide(&builder->prims, ids, count, depth, &builder->rule, &bounds, builder->scratch);
    const linked_node_t *left = build_child(builder, ids, middle, first, depth + 1);
    const linked_node_t *right = build_child(builder, ids + middle, count - middle, first + middle, depth + 1);
    node->left = reference_to(builder->heap.blocks, left);
    node->right = reference_to(builder->heap.blocks, right);
    return left && right ? node : 0;
}

static linked_node_t *build_child(
    const builder_t *builder, int *ids, const long count, const long first, const int depth)
{
    if (!builder->rule.copies) {
        return build_linked(builder, ids, count, first, depth);
    }
    int *list = copy_list(builder, ids, count);
    linked_node_t *node = list ? build_linked(builder, list, count, first, depth) : 0;
    free(list);
    return node;
}

// Writes a linked tree in depth-first order: its root at `index`, all below it from `next` on. Returns where these end.
static long flatten(
    const linked_node_t *blocks, const long reference, row_node_t *nodes, const long index, const long next)
{
    const linked_node_t *node = node_of(blocks, reference);
    if (node->count > 0) {
        store_node(&nodes[index], node->box, node->first, node->count);
        return next;
    }
    store_node(&nodes[index], node->box, next, 0);
    const long end = flatten(blocks, node->left, nodes, next, next + 2);
    return flatten(blocks, node->right, nodes, next + 1, end);
}

// Builds a subtree straight in depth-first order: its root at `index`, all below it from `next` on. Returns where these
// end. The range begins at `first` in the index array.
static long build_flat(
    const builder_t *builder, const long first, const long count, const int depth, row_node_t *nodes, const long index,
    const long next)
{
    int *ids = builder->prim_ids + first;
    const bounds_t bounds = bound_range(&builder->prims, ids, count);
    if (count <= builder->rule.leaf_size) {
        list_prims(builder, ids, count, ids);
        store_node(&nodes[index], bounds.box, first, count);
        return next;
    }
    store_node(&nodes[index], bounds.box, next, 0);
    const long middle = divide(&builder->prims, ids, count, depth, &builder->rule, &bounds, builder->scratch);
    const long end = build_flat(builder, first, middle, depth + 1, nodes, next, next + 2);
    return build_flat(builder, first + middle, count - middle, depth + 1, nodes, next + 1, end);
}
