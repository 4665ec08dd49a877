// The losses of skin.h and their gradient for one block of frames, vectorised over the frames.
//
// The kernels exist in float (optimiser) and double (evaluation, tests), each for several
// instruction sets. Every frame of a block is computed by the same operations in the same order
// whatever the width of the registers, so all of them give the same bits.
//
// For fixed rotations (envelope theorem) the gradient by the displacement u_i is, per term,
//   L_r, L_c:  2 sum_{j in N(i)} r_ij - 2 sum_{j: i in N(j)} r_ji,   r_ij = e_ij(t) - R_i e_ij(0)
//   L_a:       2 a_i - 2 sum_{j: i in K(j)} Kw_ji a_j,               a_i = V_i - sum_j Kw_ij V_j
//   L_s:       4 sum_{j in N(i)} (1 - |e_ij(0)| / |e_ij(t)|) e_ij(t)
// with e_ij = v_i - v_j. It is gathered per vertex, which needs no atomics and no order; or, where
// one thread has all vertices of a block, scattered.
#ifndef PCI_SKIN_KERNEL_H
#define PCI_SKIN_KERNEL_H

#include "core/core.h"

enum { PCI_BLOCK = 16 }; // frames per block, the innermost dimension of all per-frame arrays

// Directed edges i -> j of one term, by the vertex i.
typedef struct pci_skin_edges {
    const size_t *offsets;   // #V + 1
    const uint32_t *targets; // j
    const void *vectors;     // e_ij(0), 3 reals per edge
    const void *lengths;     // |e_ij(0)|, or NULL
    const void *constants;   // #V by 13: sum e e^T (9), sum e (3), 1 / sum |e|^2 or 0
} pci_skin_edges;

// What the kernels read and write. "real" is float or double, see pci_skin_kernel.
typedef struct pci_skin_data {
    uint32_t slots;
    const uint32_t *bones;          // #V by slots
    const void *weights;            // real, #V by slots
    pci_skin_edges ring;            // N(i), symmetric
    pci_skin_edges near;            // K(i)
    const void *near_weights;       // real, Kw_ij per edge of `near`
    const void *attachment_rest;    // real, #V by 3: a_i at rest
    const size_t *incoming_offsets; // #V + 1
    const uint32_t *incoming;       // j with i in K(j)
    const void *incoming_vectors;   // real, e_ij(0), 3 per incoming edge
    const void *incoming_weights;   // real, Kw_ji
    double scale[4];                // of the gradients of L_r, L_c, L_a, L_s

    const void *driver;  // real, #P by 3 by PCI_BLOCK: displacements of the proxy
    void *displacements; // real, #V by 3 by PCI_BLOCK: u
    void *quaternions;   // real, #V by 8 by PCI_BLOCK: rotations of L_r, L_c; in: first guess
    void *rotations;     // real, #V by 18 by PCI_BLOCK
    void *residuals;     // real, #V by 6 by PCI_BLOCK: a_i; the part of the gradient that i knows
    void *forces;        // real, #V by 3 by PCI_BLOCK: added to, `scatter` alone
    void *gradient;      // real, #V by slots: added to
} pci_skin_data;

// Counts and sums over a range of vertices, per frame of the block.
typedef struct pci_skin_sums {
    double rigid[PCI_BLOCK], collision[PCI_BLOCK], attachment[PCI_BLOCK];
    uint64_t reflections[PCI_BLOCK]; // vertices with det(S) < 0 in L_r
} pci_skin_sums;

typedef struct pci_skin_kernel {
    size_t real_size;
    // u = sum_j w_ij d_j.
    void (*displace)(const pci_skin_data *data, size_t begin, size_t end);
    // Rotations and what a vertex alone contributes to the gradient; `sums` may be NULL.
    void (*fit)(const pci_skin_data *data, size_t begin, size_t end, pci_skin_sums *sums);
    // dL/dw_ij, weights taken as free. Needs `fit` for all vertices.
    void (*gradient)(const pci_skin_data *data, size_t begin, size_t end);
    // The same in half the time, by one thread for the whole block: `scatter` adds half of dL/du to
    // `forces` instead of keeping rotations and residuals, `collect` does what `gradient` does.
    void (*scatter)(const pci_skin_data *data, size_t vertex_count, pci_skin_sums *sums);
    void (*collect)(const pci_skin_data *data, size_t begin, size_t end);
} pci_skin_kernel;

// The kernels of the best instruction set of this processor.
const pci_skin_kernel *pci_skin_kernel_float(void);
const pci_skin_kernel *pci_skin_kernel_double(void);

extern const pci_skin_kernel pci_skin_generic_float, pci_skin_generic_double;
#if defined(__x86_64__)
extern const pci_skin_kernel pci_skin_avx2_float, pci_skin_avx2_double;
extern const pci_skin_kernel pci_skin_avx512_float, pci_skin_avx512_double;
#endif

// The rotation R that maximises tr(R^T S), as unit quaternion (w, x, y, z): the largest
// eigenvector of a symmetric 4 by 4 matrix, by Jacobi rotations. S row-major; S = 0 gives the
// identity.
void pci_rotation_by_jacobi(const double s[9], double quaternion[4]);

#endif
