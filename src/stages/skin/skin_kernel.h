// The losses of skin.h and their gradient for one block of frames and one patch of vertices,
// vectorised over the frames.
//
// The kernels exist in float (optimiser) and double (evaluation, tests), each for several
// instruction sets. Every frame of a block is computed by the same operations in the same order
// whatever the width of the registers, so all of them give the same bits.
//
// With x_ij = u_i - u_j and e_ij the edge at rest, each term pulls the two ends of an edge i -> j
// together or apart by the same force; for fixed rotations (envelope theorem) half of it is
//   L_r, L_c:  s_ij (x_ij - (R_i - I) e_ij)      for j in N(i), in K(i)
//   L_a:       Kw_ij a_i                         for j in K(i), a_i = a_i(0) + sum_j Kw_ij x_ij
//   L_s:       2 s_ij (1 - |e_ij| / |e_ij(t)|) e_ij(t)   once for each edge of the ring
// so a list of edges serves all of them. What reaches vertices of other patches is added up there.
#ifndef PCI_SKIN_KERNEL_H
#define PCI_SKIN_KERNEL_H

#include "geometry/rotation.h"

enum {
    PCI_BLOCK = 16,    // frames per block, the innermost dimension of all per-frame arrays
    PCI_SKIN_BATCH = 3 // vertices
};

// Edges of one vertex i, in five runs: to j in N(i) only, to N(i) and K(i), to K(i) only; each of
// the first two cut where j > i begins or ends, so that these edges of the ring are in one piece.
typedef struct pci_skin_runs {
    uint32_t begin, upper, near, upper_end, ring_end, end;
} pci_skin_runs;

// Some vertices with all that they need. "real" is float or double, see pci_skin_kernel.
typedef struct pci_skin_patch {
    uint32_t own_count;
    uint32_t local_count;      // and their neighbours
    const uint32_t *vertices;  // #local, own ones first
    const pci_skin_runs *runs; // #own
    const uint32_t *targets;   // j of each edge, as local vertex
    const void *vectors;       // real, s_ij e_ij, 3 per edge
    const void *lengths;       // real, s_ij |e_ij| of the edges of the ring to j > i, in order
    const void *stiffness;     // real, s_ij per edge
    const void *near_weights;  // real, Kw_ij per edge, 0 outside K(i)
    const void *constants;     // real, #own by 16: see PCI_SKIN_RING
} pci_skin_patch;

enum { // of a vertex
    PCI_SKIN_RING =
        0, // sum s e e^T over N(i), 6 entries: xx, xy, xz, yy, yz, zz; 1 / sum s |e|^2 or 0
    PCI_SKIN_NEAR = 7,      // sum s e e^T over K(i)
    PCI_SKIN_ATTACHED = 13, // a_i(0), 3
    PCI_SKIN_CONSTANTS = 16
};

// Where x^ of a vertex is in an array of them. One column is 1 for all: the array has a single one.
static inline size_t pci_skin_point_at(size_t vertex, size_t columns) {
    return columns == 1 ? 0 : vertex * columns;
}

// What all patches share.
typedef struct pci_skin_data {
    uint32_t slots;
    uint32_t columns;      // of the driver, see skin_driver.h
    const uint32_t *bones; // #V by slots
    const double *weights; // #V by slots
    const void *points;    // real, see pci_skin_point_at
    double scale[4];       // of the gradients of L_r, L_c, L_a, L_s
} pci_skin_data;

// Of one thread, for the patch in hand.
typedef struct pci_skin_buffers {
    void *displacements; // real, #local by 3 by PCI_BLOCK: u
    void *forces;        // real, #local by 3 by PCI_BLOCK: half of dE/du
} pci_skin_buffers;

// Counts and sums over a patch, per frame of the block.
typedef struct pci_skin_sums {
    double losses[3][PCI_BLOCK];     // L_r, L_c, L_a
    uint64_t reflections[PCI_BLOCK]; // vertices with det(S) < 0 in L_r
} pci_skin_sums;

enum { PCI_SKIN_STRIDE = 16 }; // strides are multiples of this

// What sweeps multiply: a row of M with what its neighbours have moved, and that with rows of G.
// See skin_quadratic.h. Arrays of float are aligned to 64 bytes.
typedef struct pci_skin_rows {
    size_t stride;
    const float *moved;      // rows of this stride
    const float *gram;       // likewise
    size_t entry_count;      // of the row of M
    const uint32_t *entries; // rows of `moved`
    const float *values;
} pci_skin_rows;

typedef struct pci_skin_kernel {
    size_t real_size;
    // In float: sum (stride) = the moved rows times the values; products[i] = that times row
    // numbers[i] of `gram`.
    void (*multiply_rows)(const pci_skin_rows *rows, size_t count, const uint32_t *numbers,
                          float *sum, float *products);
    // `driver`: real, #P by columns by 3 by PCI_BLOCK, see skin_driver.h. `sums`: added to, or
    // NULL. `gradient`: real, #local by slots, dL/dw is added with the weights taken as free; or
    // NULL.
    void (*evaluate)(const pci_skin_data *data, const pci_skin_patch *patch, const void *driver,
                     const pci_skin_buffers *buffers, pci_skin_sums *sums, void *gradient);
} pci_skin_kernel;

// The kernels of the best instruction set of this processor.
const pci_skin_kernel *pci_skin_kernel_float(void);
const pci_skin_kernel *pci_skin_kernel_double(void);

extern const pci_skin_kernel pci_skin_generic_float, pci_skin_generic_double;
#if defined(__x86_64__)
extern const pci_skin_kernel pci_skin_avx2_float, pci_skin_avx2_double;
extern const pci_skin_kernel pci_skin_avx512_float, pci_skin_avx512_double;
#endif

#endif
