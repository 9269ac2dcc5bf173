// Where the blocks of an instance's geometry begin: those of triangles and of spheres are in buffers of their own.

#include "traversal/traverse.cl"

INLINED const global block_t *find_blocks(
    const global instance_t *instance, const global block_t *blocks, const global float *spheres)
{
#if HAS_SPHERES
    if (instance->kind == KIND_SPHERES) {
        return (const global block_t *)((const global sphere_block_t *)spheres + instance->first_block);
    }
#endif
    return blocks + instance->first_block;
}
