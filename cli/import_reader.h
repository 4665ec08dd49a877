// A scene that the import child is reading: what import_assimp.c (files, parts, materials) and
// import_skeleton.c (nodes, joints, poses) share. Only they know assimp.
#ifndef CLI_IMPORT_READER_H
#define CLI_IMPORT_READER_H

#include <string.h>

#include <assimp/scene.h>

#include "scene.h"

// An affine map, three rows of four.
typedef struct affine {
    double m[12];
} affine;

typedef struct node_entry {
    const struct aiNode *node;
    affine world;
    size_t order;
    size_t parent; // in the order of the tree; SIZE_MAX: none
} node_entry;

typedef struct scene_reader {
    int descriptor;
    const struct aiScene *source;
    node_entry *nodes; // in the order of the tree, then sorted by name
    size_t node_capacity;
    affine map;          // of the file's axes and unit
    bool morphed;        // by the targets of its meshes
    uint32_t *joint_of;  // per node in the order of the tree, UINT32_MAX: no joint
    size_t *joint_nodes; // node of each joint
    scene_data scene;    // arrays that grow
    size_t part_capacity, vertex_capacity, triangle_capacity;
} scene_reader;

// Writes all bytes to the parent; ends the process when nobody reads.
void import_write(int descriptor, const void *bytes, size_t size);
// Tells the parent what is wrong and ends the process.
__attribute__((format(printf, 2, 3))) _Noreturn void import_fail(scene_reader *reader,
                                                                 const char *format, ...);
// Grows an array to hold `needed` elements; new elements are zero. Never NULL.
void *import_grow(scene_reader *reader, void *array, size_t *capacity, size_t needed, size_t size);
void *import_allocate(scene_reader *reader, size_t count, size_t size);

static inline affine affine_from_assimp(const struct aiMatrix4x4 *a) {
    const affine result = {{(double)a->a1, (double)a->a2, (double)a->a3, (double)a->a4,
                            (double)a->b1, (double)a->b2, (double)a->b3, (double)a->b4,
                            (double)a->c1, (double)a->c2, (double)a->c3, (double)a->c4}};
    return result;
}

static inline affine affine_multiply(const affine *a, const affine *b) {
    affine result;
    for (size_t row = 0; row < 3; ++row) {
        const double *r = &a->m[4 * row];
        for (size_t column = 0; column < 4; ++column) {
            result.m[4 * row + column] = r[0] * b->m[column] + r[1] * b->m[4 + column] +
                                         r[2] * b->m[8 + column] + (column == 3 ? r[3] : 0.0);
        }
    }
    return result;
}

// Cofactors of the linear part: determinant times inverse transpose, row by row. Returns the
// determinant.
static inline double affine_cofactors(const affine *a, double c[9]) {
    const double *m = a->m;
    c[0] = m[5] * m[10] - m[6] * m[9];
    c[1] = m[6] * m[8] - m[4] * m[10];
    c[2] = m[4] * m[9] - m[5] * m[8];
    c[3] = m[2] * m[9] - m[1] * m[10];
    c[4] = m[0] * m[10] - m[2] * m[8];
    c[5] = m[1] * m[8] - m[0] * m[9];
    c[6] = m[1] * m[6] - m[2] * m[5];
    c[7] = m[2] * m[4] - m[0] * m[6];
    c[8] = m[0] * m[5] - m[1] * m[4];
    return m[0] * c[0] + m[1] * c[1] + m[2] * c[2];
}

static const affine affine_identity = {{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};

static inline bool affine_is_identity(const affine *a) {
    return memcmp(a, &affine_identity, sizeof(*a)) == 0;
}

// ---- import_skeleton.c --------------------------------------------------------------------------

// Collects the tree below a node of index `parent`, SIZE_MAX: the root.
void import_nodes(scene_reader *reader, const struct aiNode *node, size_t parent);
// The nodes sorted by name.
node_entry *import_sort_nodes(scene_reader *reader);
// Numbers the nodes that vertices follow, in the order of the tree: bones, and nodes of rigid
// meshes where anything is animated.
void import_joints(scene_reader *reader, const node_entry *by_name);
// Samples every animation 60 times a second, the last pose exactly at its end; fewer times where
// that would be more than fits.
void import_poses(scene_reader *reader);
// The map of each vertex in the rest pose: sum of weight * joint * inverse bind. The transform of
// the mesh's own node does not count for a skinned mesh, unless a vertex has no weight.
affine *import_skin_maps(scene_reader *reader, const struct aiMesh *mesh, const affine *node,
                         const node_entry *by_name);
// The four largest weights of each vertex of a mesh; `joints` and `weights` are #vertices by 4.
void import_weights(scene_reader *reader, const struct aiMesh *mesh, const node_entry *entry,
                    const node_entry *by_name, uint32_t *joints, float *weights);

#endif
