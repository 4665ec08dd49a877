// The default optimiser: alternates between all rotations and Gauss-Seidel sweeps over the
// vertices, each an exact small program on the simplex. For skin*.c.
//
// L_f of skin.h: with u*_i = sum_c b_ic d_c of given weights b_i,
//   sum_t |u_i - u*_i|^2 = w^T G w - 2 w^T G b + b^T G b,
// which needs no pass over the frames. Nor does the noise of variance s: independent motions of the
// bones add s I to G and, with the rotations as they are,
//   s / 2 sum_ij M_ij <w_i - b_i / 2, w_j - b_j / 2>
// to the energy, M of skin_quadratic.h without L_f and L_s.
#ifndef PCI_SKIN_ALTERNATE_H
#define PCI_SKIN_ALTERNATE_H

#include "proxycloth/skin.h"
#include "stages/skin/skin_gram.h"
#include "stages/skin/skin_quadratic.h"

typedef struct pci_skin_alternation {
    pci_skin_frames frames;
    pci_skin_quadratic quadratic;
    pci_skin_gram *gram;         // the caller's
    pci_skin_pairs pairs;        // where that has no matrix
    pci_skin_level level;        // that the quadratic and the constants are for
    double scale[4];             // of the losses
    uint32_t *allowed;           // #V, see pci_skin_quadratic
    double follow;               // factor of L_f
    const pc_skin *followed;     // b of L_f
    float *constants;            // #V by slots: what L_f and the noise add to the gradient with b
    double *pulls;               // #threads by #P, 0 but while a row is in hand
    double spacing;              // of the proxy's vertices, squared
    float **gradient;            // #groups, members by slots; in the rows that the patches own
    float *moved;                // #V by slots: since the gradient was found
    pci_skin_measures *measures; // #patches
    uint32_t remembered;         // steps that rounds start from, at most PCI_SKIN_SECANTS
    uint32_t rounds;             // so far
    double losses;               // L_r, L_c, L_a by scale when slots were last taken away, or 0
} pci_skin_alternation;

// False: out of memory.
bool pci_skin_alternation_build(pci_scratch *scratch, const pci_skin_problem *problem,
                                const pci_skin_kernel *kernel, pci_skin_gram *gram,
                                pci_skin_alternation *alternation);

// What L_f follows: the displacements that other weights give, which stay the caller's.
void pci_skin_alternation_follow(pci_skin_alternation *alternation, const pc_mesh *proxy,
                                 const pc_skin *followed);

// `lambda`: of L_r, L_c, L_a, L_s divided by norm and frame count; of L_f. False: out of memory.
bool pci_skin_alternation_weigh(pci_scratch *scratch, pci_skin_alternation *alternation,
                                const double lambda[4], double lambda_follow);

// At most `rounds` rounds of one pass over frames and some sweeps; stops when a round lowers the
// energy by less than `tolerance` of the losses or, while these are not known, a tenth of that of
// what all rounds of this call have. Most rounds see a sample of the frames, the last
// ones all unless `rough`.
// @param[in,out] weights  in: any; slots that are not allowed are 0.
PC_NODISCARD pc_status pci_skin_alternation_run(pci_skin_alternation *alternation, uint32_t rounds,
                                                double tolerance, bool rough, double progress_begin,
                                                double progress_end, double *weights);

// The losses of any weights over all frames, or what those of the sample tell of them.
PC_NODISCARD pc_status pci_skin_alternation_measure(pci_skin_alternation *alternation,
                                                    pci_skin_level level, const double *weights,
                                                    pci_skin_measures *measures);

// Leaves `kept` slots per row. `measures`: of the weights before, by the sample.
PC_NODISCARD pc_status pci_skin_alternation_prune(pci_skin_alternation *alternation, uint32_t kept,
                                                  double *weights, pci_skin_measures *measures);

// Moves the slots that are left to the front, where a row may have held more than `kept` the
// heaviest, and makes rows as short as that: of the alternation's arrays, and of `bones` (those of
// the problem) and `weights`. The problem has `kept` slots from then on, which the caller sets.
void pci_skin_alternation_compact(pci_skin_alternation *alternation, uint32_t kept, uint32_t *bones,
                                  double *weights);

#endif
