// The blocks of all shapes: those of each kind are in a buffer of their own.

#include "traversal/traverse.cl"

typedef struct {
    const global block_t *own;  // of triangles; or of a lone shape, whatever its kind
    const global float *spheres;
} kind_blocks_t;

// Where the blocks of an instance's shape begin.
INLINED const global block_t *find_blocks(const global instance_t *instance, const kind_blocks_t blocks)
{
    if (IS_SPHERES(instance->kind)) {
        return (const global block_t *)((const global sphere_block_t *)blocks.spheres + instance->first_block);
    }
    return blocks.own + instance->first_block;
}
