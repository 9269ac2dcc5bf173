// The blocks of the layout `bvh8c`, in which triangles share vertices: by clbvh/layouts/shared_blocks.py, which says
// what a block consists of.

#include "structs.cl"
#include "triangles/collinear.cl"

#define WIDTH 8
#define UNIT_WORDS 4
#define MOST_VERTICES (1 << SHARED_VERTEX_BITS)

// Prefetch distance in leaves, of vertices; of faces it is twice as far.
#define LEAVES_AHEAD 4

// Vertex number and coordinates of all corners of a degenerate triangle.
#define NO_VERTEX -1
#define MISSING 0x7fc00000

typedef struct {
    const float (*vertices)[3];
    const int (*faces)[3];
    const bool *degenerate;
} mesh_t;

// The vertices of a block, with their numbers in the mesh, and those of its triangles' corners.
typedef struct {
    int vertex_count;
    int triangle_count;
    int known[MOST_VERTICES];
    int3 shared[MOST_VERTICES];
    int corners[3][WIDTH];
} block_t;

static double3 load_corner(const mesh_t *mesh, const int vertex)
{
    return convert_double3(load3(mesh->vertices[vertex]));
}

static bool is_degenerate(const mesh_t *mesh, const int prim)
{
    const int *ids = mesh->faces[prim];
    return mesh->degenerate ? mesh->degenerate[prim] :
        is_collinear(load_corner(mesh, ids[0]), load_corner(mesh, ids[1]), load_corner(mesh, ids[2]));
}

// The vertex of a block, which is added if it is not there yet, and then counted in `count`; MOST_VERTICES if the block
// is full.
static int find_vertex(block_t *block, const mesh_t *mesh, const int vertex, int *count)
{
    for (int i = 0; i < *count; i++) {
        if (block->known[i] == vertex) {
            return i;
        }
    }
    // By its bits: zeros differ by their sign.
    const int3 bits = vertex == NO_VERTEX ? (int3)(MISSING) : as_int3(load3(mesh->vertices[vertex]));
    for (int i = 0; i < *count; i++) {
        if (all(block->shared[i] == bits)) {
            return i;
        }
    }
    if (*count < MOST_VERTICES) {
        block->known[*count] = vertex;
        block->shared[*count] = bits;
        return (*count)++;
    }
    return MOST_VERTICES;
}

// Takes the first of some triangles into a block, as many as it has room for.
static void fill_block(block_t *block, const mesh_t *mesh, const int *prims, const int prim_count)
{
    block->vertex_count = 0;
    block->triangle_count = 0;
    for (int slot = 0; slot < prim_count; slot++) {
        const bool is_none = is_degenerate(mesh, prims[slot]);
        int count = block->vertex_count;
        for (int corner = 0; corner < 3; corner++) {
            const int vertex = is_none ? NO_VERTEX : mesh->faces[prims[slot]][corner];
            const int index = find_vertex(block, mesh, vertex, &count);
            if (index == MOST_VERTICES) {
                return;
            }
            block->corners[corner][slot] = index;
        }
        block->vertex_count = count;
        block->triangle_count++;
    }
}

// Writes a block into words; returns the number of its units.
static int write_block(const block_t *block, const int *prims, const bool is_last, int *words)
{
    const int word_count = SHARED_HEADER + 3 * block->vertex_count + block->triangle_count;
    const int unit_count = (word_count + UNIT_WORDS - 1) / UNIT_WORDS;
    for (int corner = 0; corner < 3; corner++) {
        uint row = 0;
        for (int slot = 0; slot < block->triangle_count; slot++) {
            row |= (uint)block->corners[corner][slot] << SHARED_VERTEX_BITS * slot;
        }
        words[corner] = (int)row;
    }
    words[3] = block->vertex_count | block->triangle_count << 8 | (is_last ? 0 : unit_count) << 16;
    int *next = words + SHARED_HEADER;
    for (int axis = 0; axis < 3; axis++) {
        for (int vertex = 0; vertex < block->vertex_count; vertex++) {
            *next++ = block->shared[vertex][axis];
        }
    }
    for (int slot = 0; slot < block->triangle_count; slot++) {
        *next++ = prims[slot];
    }
    while (next < words + UNIT_WORDS * unit_count) {
        *next++ = 0;
    }
    return unit_count;
}

// Asks for the memory of later leaves: their triangles lie anywhere.
static void ask_ahead(const mesh_t *mesh, const int (*prims)[WIDTH], const long leaf_count, const long leaf)
{
    if (leaf + 2 * LEAVES_AHEAD >= leaf_count) {
        return;
    }
    for (int slot = 0; slot < WIDTH; slot++) {
        WILL_READ(mesh->faces[prims[leaf + 2 * LEAVES_AHEAD][slot]]);
        const int *ids = mesh->faces[max(prims[leaf + LEAVES_AHEAD][slot], 0)];
        for (int corner = 0; corner < 3; corner++) {
            WILL_READ(mesh->vertices[ids[corner]]);
        }
    }
}

// Writes the blocks of leaves; returns the number of their units.
//
// degenerate          whether each face has no area; or none, where the vertices tell
// begins              written: the first unit of each leaf
// words               written, with room for leaves without common vertices
loop long write_leaves(
    const long vertex_count, const float vertices[vertex_count][3], const long face_count,
    const int faces[face_count][3], const bool *degenerate, const long leaf_count, const int prims[leaf_count][8],
    long begins[leaf_count], int *words)
{
    const mesh_t mesh = {vertices, faces, degenerate};
    block_t block;
    long unit_count = 0;
    for (long leaf = 0; leaf < leaf_count; leaf++) {
        ask_ahead(&mesh, prims, leaf_count, leaf);
        begins[leaf] = unit_count;
        const int *own = prims[leaf];
        int prim_count = 0;
        while (prim_count < WIDTH && own[prim_count] != NO_PRIM) {
            prim_count++;
        }
        for (int begin = 0; begin < prim_count; begin += block.triangle_count) {
            fill_block(&block, &mesh, own + begin, prim_count - begin);
            const bool is_last = begin + block.triangle_count == prim_count;
            unit_count += write_block(&block, own + begin, is_last, words + UNIT_WORDS * unit_count);
        }
    }
    return unit_count;
}

// Gives the children of nodes that are leaves the number of the leaf's first unit.
loop void name_leaves(
    const long leaf_count, const long begins[leaf_count], const long node_count, bvh8_node_t nodes[node_count])
{
    for (long node = 0; node < node_count; node++) {
        for (int slot = 0; slot < WIDTH; slot++) {
            const int child = nodes[node].child[slot];
            nodes[node].child[slot] = child < 0 ? ~(int)begins[~child] : child;
        }
    }
}
