// The energy of skin.h as a quadratic function of the weights, rotations held fixed. For skin*.c.
//
//   E(W) = E(W0) + <g0, W - W0> + 1/2 sum (w - w0)_ib H_ib,jc (w - w0)_jc,
//   H_ib,jc = M_ij x^_i^T G[B_ib, B_jc] x^_j
// with M = 2 (weighted Laplacians of L_r, L_c, L_s and L_a + diagonal of L_f), and x^ and A of
// skin_driver.h: G[b, c] = sum A_b^T A_c over all frames. With one column G is the Gram matrix of
// the displacements of the proxy, and x^ = 1.
//
// The rows of K sum to 0, so |x_i - sum_j Kw_ij x_j|^2 <= sum_j Kw_ij |x_i - x_j|^2 (Jensen): this
// bound stands for L_a. M then has an entry for each neighbour only, half of those of K^T K.
#ifndef PCI_SKIN_QUADRATIC_H
#define PCI_SKIN_QUADRATIC_H

#include "stages/skin/skin_pairs.h"

enum { PCI_SKIN_GROUP = 64 }; // vertices that one thread visits in turn

typedef struct pci_skin_move {
    uint32_t row, bone;
    float step; // w - w0
} pci_skin_move;

// What the vertices of one group need, close together in memory.
typedef struct pci_skin_group {
    size_t first;             // into members
    uint32_t own_count;       // rows of the group
    uint32_t row_count;       // and of all vertices that it knows
    const uint32_t *vertices; // #rows, those of the group first
    const float *gradient;    // rows of the group by slots: g0
    uint32_t own_bone_count, bone_count;
    size_t stride;          // numbers per row: width by #bones, filled up
    uint32_t *bone_numbers; // #P: 1 + number of the bone, or 0, while the group is loaded
    uint32_t *places;       // slots of the rows of the group: numbers of the bones
    uint32_t *bones;        // #bones, those of the group first
    size_t move_count;
    pci_skin_move *moves; // slots of all rows that have moved when the group is loaded
    float *moved;         // #rows by stride: (w - w0) x^ of each bone
    float *gram;          // #own bones width by stride: G
    double *own_gram;     // #own bones width by #own bones width
    float *sum;           // stride
    uint32_t *faces;      // rows of the group: as those of the quadratic, for larger faces
    float *factors;
} pci_skin_group;

typedef struct pci_skin_quadratic {
    pc_context *context;
    const pci_skin_kernel *kernel;
    size_t vertex_count, proxy_count;
    uint32_t slots, widest; // now, and at first
    uint32_t width;         // numbers of x^
    const uint32_t *bones;  // #V by slots
    const double *points;   // x^, see pci_skin_point_at
    // Vertices in groups; groups of one colour share no entry of M.
    const uint32_t *members; // #V
    uint32_t group_count;
    uint32_t *colours;     // #groups, from 1
    uint32_t *groups;      // 2 #groups: by colour, then from the last colour to the first
    uint32_t *group_of;    // #V
    atomic_uint *finished; // #groups: sweeps that are done
    size_t *known_offsets; // #groups + 1
    uint32_t *known;       // the vertices of each group in order, then their neighbours
    size_t *offsets;       // #V + 1: rows of M by member: the diagonal, the ring, all others
    uint32_t *entries;     // places among the vertices that the group knows
    float *values;
    const double *gram; // G, #P width by #P width; or NULL:
    const pci_skin_pairs *pairs;
    const uint32_t *allowed; // #V, bit k: slot k may have weight
    // Where a row lies on the face of the free slots, its gradient g moves it by -C g / M_ii to the
    // minimum there. F of C (pci_simplex_factor of x^T G x) stays as long as the face and G do.
    uint32_t *faces; // by member, bits of the free slots that F is for, 0: none
    float *factors;  // by member: F of faces of at most `kept` slots
    uint32_t kept;
    pci_skin_group *loaded; // #threads
} pci_skin_quadratic;

// The first member of a group, or #V behind the last group.
static inline size_t pci_skin_group_begin(const pci_skin_quadratic *quadratic, size_t group) {
    const size_t begin = PCI_SKIN_GROUP * group;
    return begin < quadratic->vertex_count ? begin : quadratic->vertex_count;
}

// `scale`: factors of the losses; `diagonal`: what else M / 2 has there. `points`, `gram` and
// `allowed` stay the caller's; so do the pairs that are given later where `gram` is NULL. False:
// out of memory.
bool pci_skin_quadratic_build(pci_scratch *scratch, const pci_skin_problem *problem,
                              const pci_skin_kernel *kernel, const double *points,
                              const double scale[4], double diagonal, const double *gram,
                              const uint32_t *allowed, pci_skin_quadratic *quadratic);

// Other factors of the losses. False: out of memory.
bool pci_skin_quadratic_weigh(pci_scratch *scratch, const pci_skin_problem *problem,
                              const double scale[4], double diagonal,
                              pci_skin_quadratic *quadratic);

// Takes notice of other numbers in G, or other slots.
void pci_skin_quadratic_use(pci_skin_quadratic *quadratic, uint32_t slots);

// Gauss-Seidel over the groups by colour, every other time from the last colour to the first; each
// is swept there and back: every vertex is minimised exactly over the simplex, twice.
// @param[in]     gradient  #groups: g0 of the members, by slots.
// @param[in,out] moved     #V by slots: W - W0.
// @param[in,out] weights   #V by slots: W.
void pci_skin_quadratic_sweep(const pci_skin_quadratic *quadratic, float *const *gradient,
                              uint32_t sweeps, float *moved, double *weights);

// Sweeps that take slots away until each row has `kept`: the one whose loss costs least while the
// other slots of the row adapt, by the second derivatives (Hassibi, Stork, "Optimal brain surgeon",
// 1993). A row is visited several times and may choose other slots when its neighbours have chosen
// theirs. Clears the bits of those it loses in `allowed`, which is the array of the quadratic.
void pci_skin_quadratic_prune(const pci_skin_quadratic *quadratic, float *const *gradient,
                              uint32_t kept, uint32_t *allowed, float *moved, double *weights);

#endif
