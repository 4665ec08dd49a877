// The energy of skin.h as a quadratic function of the weights, rotations held fixed. For skin*.c.
//
//   E(W) = E(W0) + <g0, W - W0> + 1/2 sum (w - w0)_ib H_ib,jc (w - w0)_jc,
//   H_ib,jc = M_ij x^_i^T G[B_ib, B_jc] x^_j
// with M = 2 (weighted Laplacians of L_r, L_c and L_s + K^T K of L_a + diagonal of L_t), and x^ and
// A of skin_driver.h: G[b, c] = sum A_b^T A_c over all frames. With one column G is the Gram matrix
// of the displacements of the proxy, and x^ = 1.
#ifndef PCI_SKIN_QUADRATIC_H
#define PCI_SKIN_QUADRATIC_H

#include "stages/skin_driver.h"

// Factor of the Laplacian over the rings that stands for L_r and L_s. L_s resists along an edge,
// one direction of three: as much in all of them would bound the energy, but make the steps short.
// With half of the bound or more, sweeps still converge.
double pci_skin_ring_scale(const double scale[4]);

// What the vertices of one group need, close together in memory.
typedef struct pci_skin_group {
    uint32_t row_count, bone_count;
    uint32_t *row_numbers;  // #V: 1 + number of the row, or 0
    uint32_t *bone_numbers; // #P: likewise, while the group is loaded
    uint32_t *vertices;     // #rows, those of the group first
    uint32_t *row_offsets;  // #rows + 1
    uint32_t *places;       // slots of all rows: numbers of the bones
    double *moved;          // slots of all rows: w - w0
    uint32_t *positions;    // of the slots of the group, in the two arrays above
    uint32_t *bones;        // #bones
    double *gram;           // #bones width by #bones width, rows of the bones of the group
    double *accumulator;    // #bones width
} pci_skin_group;

typedef struct pci_skin_quadratic {
    pc_context *context;
    size_t vertex_count, proxy_count;
    uint32_t slots, width; // width: numbers of x^
    const uint32_t *bones; // #V by slots
    const double *points;  // #V by width: x^
    size_t *offsets;       // #V + 1: rows of M, the diagonal is the first entry
    uint32_t *columns;
    double *values;
    const double *gram;      // G, #P width by #P width
    const uint32_t *allowed; // #V, bit k: slot k may have weight
    // Vertices in groups; groups of one colour share no entry of M.
    uint32_t group_count, colour_count;
    uint32_t *group_offsets;  // #groups + 1, into members
    const uint32_t *members;  // #V
    uint32_t *colour_offsets; // #colours + 1, into groups
    uint32_t *groups;         // #groups, by colour
    pci_skin_group *loaded;   // #threads
} pci_skin_quadratic;

// `scale`: factors of the losses; `diagonal` (#V): what else M / 2 has there. `points`, `gram` and
// `allowed` stay the caller's. False: out of memory.
bool pci_skin_quadratic_build(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double *points, const double scale[4], const double *diagonal,
                              const double *gram, const uint32_t *allowed,
                              pci_skin_quadratic *quadratic);

// Other factors of the losses. False: out of memory.
bool pci_skin_quadratic_weigh(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double scale[4], const double *diagonal,
                              pci_skin_quadratic *quadratic);

// One Gauss-Seidel sweep over all vertices, each minimised exactly over the simplex.
// @param[in]     reference, gradient  W0 and g0.
// @param[in,out] weights              W.
void pci_skin_quadratic_sweep(const pci_skin_quadratic *quadratic, const double *reference,
                              const double *gradient, bool backward, double *weights);

// A sweep that takes slots away until each row has `kept`: the one whose loss costs least while the
// other slots of the row adapt, by the second derivatives (Hassibi, Stork, "Optimal brain surgeon",
// 1993). Clears their bits in `allowed`, which is the array of the quadratic.
void pci_skin_quadratic_prune(const pci_skin_quadratic *quadratic, const double *reference,
                              const double *gradient, uint32_t kept, uint32_t *allowed,
                              double *weights);

#endif
