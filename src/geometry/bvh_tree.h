// The tree of boxes below bvh.h: it proposes triangles, and decides nothing. Everything is in
// float, in coordinates where the mesh fits a cube of side 1 around the origin. Boxes are larger
// than the triangles by PCI_PADDING, which exceeds all rounding of boxes, rays and points.
#ifndef PCI_BVH_TREE_H
#define PCI_BVH_TREE_H

#include "core/core.h"
#include "geometry/bvh.h"

struct RTCBuildPrimitive;

#define PCI_PADDING 2e-6

// Beyond this distance from the origin the bounds of a float query would mean nothing: every
// triangle is visited.
#define PCI_FARTHEST_POINT 1e6

enum {
    PCI_BVH_WIDTH = 8,
    PCI_BVH_LEAF = 4,
    PCI_BVH_LEVELS = 33,                   // of nodes, at most
    PCI_BVH_MOST_TRIANGLES = INT32_MAX / 2 // children are told apart by the last bit
};

// Its children's boxes, axis by axis. Boxes without a child hold nothing: lower > upper.
typedef struct pci_bvh_node {
    float lower[3][PCI_BVH_WIDTH], upper[3][PCI_BVH_WIDTH];
    uint32_t child[PCI_BVH_WIDTH]; // 2 * node or 2 * leaf + 1
    uint32_t padding[PCI_BVH_WIDTH];
} pci_bvh_node;

// Triangles, and then PC_INVALID_INDEX with the corners of the first one.
typedef struct pci_bvh_leaf {
    uint32_t triangles[PCI_BVH_LEAF];
    uint32_t corners[3][PCI_BVH_LEAF];
} pci_bvh_leaf;

typedef struct pci_bvh_tree {
    pci_bvh_node *nodes; // the root is the first one
    pci_bvh_leaf *leaves;
    const double *positions; // of the corners
    size_t node_count, leaf_count;
} pci_bvh_tree;

// Builds the tree, by Embree, in `memory`, over the boxes of triangles, #count, which are permuted.
// Corners are missing yet. A careful tree takes three times as long, queries then a sixth less.
pc_status pci_bvh_build(pc_context *context, const char *stage, pci_scratch *memory,
                        struct RTCBuildPrimitive *boxes, size_t count, bool careful,
                        pci_bvh_tree *tree);

// Where to search: in double, and in the coordinates of the boxes.
typedef struct pci_bvh_ball {
    double point[3];
    float centre[3], radius; // a radius that is not finite takes in all
} pci_bvh_ball;

typedef struct pci_bvh_ray {
    double origin[3];
    size_t axis[3];  // the last one is the direction's largest component
    double shear[3]; // takes the direction to (0, 0, 1)
    float start[3], direction[3], reach;
} pci_bvh_ray;

// Called with a leaf whose box is within the radius, and the squared distances of its triangles.
// Returns the radius from now on; less than 0: nothing else is asked for.
typedef float (*pci_bvh_visit)(void *user, const pci_bvh_leaf *leaf, const double *distances2,
                               float radius);

// Called with a leaf whose box is met by the ray within its reach, and those of its triangles that
// the line meets, a bit for each. Returns the reach from now on.
typedef float (*pci_bvh_strike)(void *user, const pci_bvh_leaf *leaf, uint32_t met, float reach);

typedef struct pci_bvh_kernel {
    // Nearest boxes first, by and large.
    void (*around)(const pci_bvh_tree *tree, const pci_bvh_ball *ball, pci_bvh_visit visit,
                   void *user);
    void (*along)(const pci_bvh_tree *tree, const pci_bvh_ray *ray, pci_bvh_strike strike,
                  void *user);
} pci_bvh_kernel;

extern const pci_bvh_kernel pci_bvh_generic;
extern const pci_bvh_kernel pci_bvh_avx2; // x86-64 with AVX2

const pci_bvh_kernel *pci_bvh_best_kernel(void);

struct pci_bvh {
    const pc_mesh *mesh;
    pci_bvh_tree tree;
    const pci_bvh_kernel *kernel;
    pci_scratch memory;            // of the tree
    double minimum[3], maximum[3]; // of the triangles
    double centre[3];
    double scale; // normalised = (position - centre) * scale
    bool repeats; // triangles that repeat an earlier one are left out
};

static inline const double *pci_bvh_corner(const pc_mesh *mesh, size_t triangle, size_t c) {
    return &mesh->positions[3 * (size_t)mesh->triangles[3 * triangle + c]];
}

// How many boxes hold the middle of a triangle, on average over some.
double pci_bvh_overlap(const pci_bvh *bvh);

#endif
