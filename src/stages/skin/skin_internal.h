// The weight problem with explicit neighbourhoods and candidates. For skin*.c and their tests.
#ifndef PCI_SKIN_INTERNAL_H
#define PCI_SKIN_INTERNAL_H

#include "core/core.h"
#include "proxycloth/mesh.h"
#include "stages/skin/skin_kernel.h"

enum { PCI_SKIN_NEIGHBOURS_MAX = 32 };

typedef struct pci_skin_problem {
    size_t vertex_count;
    const double *rest;         // #V by 3
    const size_t *ring_offsets; // #V + 1
    const uint32_t *ring;       // N(i): vertices joined to i by an edge
    const uint32_t *ranks;      // #V: of vertices as near as others, the least are in K(i); or NULL
    uint32_t near_count;        // k_K
    const uint32_t *near;       // K(i): #V by near_count
    const double *near_sums;    // #V: see pci_skin_near_weight
    double near_epsilon;        // epsilon_z of (10)
    double norms[3];            // of L_r, L_c, L_a; see pc_skin_losses
    double typical;             // 0, or the squared length at which an edge has stiffness 1
    bool coarse;                // few of the vertices stand for all: room per vertex is no matter
    const uint32_t *order;      // #V, along a curve through space, for patches and groups
    size_t proxy_count;
    const double *proxy_rest; // #P by 3
    size_t frame_count;
    const double *frames;    // #frames by #P by 3, absolute
    const double *rotations; // #frames by #P by 4, unit quaternions (x, y, z, w); NULL: none turns
    uint32_t slots;
    const uint32_t *bones;          // B(i): #V by slots
    struct pci_skin_layers *layers; // skin_layers.h, or NULL
} pci_skin_problem;

// Fills everything that follows from the surface alone; the arrays come from scratch memory.
// `ranks` stays the caller's.
bool pci_skin_problem_build(pci_scratch *scratch, const pc_mesh *surface, const uint32_t *ranks,
                            uint32_t neighbours, pci_skin_problem *problem);

// The same for points and rings that are there. False: out of memory.
bool pci_skin_problem_finish(pci_scratch *scratch, uint32_t neighbours, pci_skin_problem *problem);

// Makes the edges of L_r, L_c and L_s count alike whatever their length: stiffness falls with the
// squared length. `norms` follow.
void pci_skin_problem_equalize(pci_skin_problem *problem);

// Kw of the neighbour near[e] of vertex i, which sum to 1 over its neighbours; V - Kw V is K V of
// equation (10). Found again from the distance, by division: for loops that run once.
double pci_skin_near_weight(const pci_skin_problem *problem, size_t i, size_t e);

// Factor of the edge from i to j in L_r, L_c and L_s; 1 for the paper's losses.
double pci_skin_stiffness(const pci_skin_problem *problem, size_t i, size_t j);

typedef struct pci_skin_measures {
    double losses[3];     // L_r, L_c, L_a, raw sums
    uint64_t reflections; // vertex-frames with det(S) < 0 in L_r
} pci_skin_measures;

// Losses for given weights, #V by slots.
PC_NODISCARD pc_status pci_skin_measure(pc_context *context, const pci_skin_problem *problem,
                                        const pci_skin_kernel *kernel, const double *weights,
                                        pci_skin_measures *measures);

// sum_x scale_x dL_x/dW over all frames with the entries of W taken as free, #V by slots. Kernels
// in float leave out a part that is constant along each row.
PC_NODISCARD pc_status pci_skin_gradient(pc_context *context, const pci_skin_problem *problem,
                                         const pci_skin_kernel *kernel, const double *weights,
                                         const double scale[4], double *gradient);

typedef struct pci_skin_descent {
    double lambda[3]; // of the losses divided by norm and frame count
    uint32_t epochs, batch;
    double learning_rate, weight_decay;
    double epsilon; // of Adam
    bool decay;     // the learning rate falls to 0 along a half cosine
    uint32_t seed;
    double progress_begin, progress_end;
} pci_skin_descent;

// Minimises over the surrogate s (#V by slots, in and out) with AdamW; w = |s| / sum |s|.
PC_NODISCARD pc_status pci_skin_descend(pc_context *context, const pci_skin_problem *problem,
                                        const pci_skin_kernel *kernel,
                                        const pci_skin_descent *settings, double *surrogate);

// w = |s| / sum |s| of one row; returns the sum. Equal weights where all s are 0.
double pci_skin_normalize(const double *surrogate, uint32_t slots, double *weights);

#endif
