// Weights of one garment on their way from the first guess to the result. For skin*.c.
#ifndef PCI_SKIN_FIT_H
#define PCI_SKIN_FIT_H

#include "proxycloth/skin.h"
#include "stages/skin/skin_alternate.h"
#include "stages/skin/skin_layers.h"
#include "stages/skin/weight_rows.h"

enum { PCI_SKIN_CANDIDATES_MAX = 32 };

// Over vertices and edges and some of the frames.
typedef struct pci_skin_motion_sums {
    double ways;    // distances from rest
    double strains; // relative changes of lengths
} pci_skin_motion_sums;

typedef struct pci_skin_fit {
    pc_context *context;
    const pc_skin_options *options;
    const pc_mesh *surface, *proxy;
    const uint32_t *ranks; // #V, or NULL; see pci_skin_problem
    const uint8_t *pinned; // of the proxy, or NULL
    pci_skin_problem problem;
    pci_skin_problem paper; // the same, of the paper's losses, while these are measured
    pci_skin_layers layers; // empty with AdamW
    pci_place *closest;     // #V, points on the proxy; the alternation forgets them
    pc_skin followed;       // see pci_skin_follow_proxy; empty with AdamW
    uint32_t *bones;        // #V by slots
    double *weights;        // #V by slots, rows of any sum
    double paper_norms[3];  // of the problem before it was equalised
    double rigid_before;    // L_r of the first guess, or 0 if it does not count
    double spatial_share;   // of lambda_c and lambda_a that is used
    double follow_share;    // of lambda_f that is used, 1 or more
    double stretch_share;   // of lambda_s that is used, 1 or more

    pci_skin_motion_sums closest_motion; // of the closest points
} pci_skin_fit;

// What L_f follows, the mean of two: closest points make the garment move as much as its proxy and
// keep lengths as it does; smoothed, they have no kinks at the proxy's edges or jumps from layer to
// layer that L_r would have to fight.
PC_NODISCARD pc_status pci_skin_follow_proxy(pc_context *context, const pc_mesh *surface,
                                             const pc_mesh *proxy, const pci_place *closest,
                                             pc_skin *followed);

// Candidates and first guess, #V by slots; `followed` or NULL. False: out of memory.
bool pci_skin_find_candidates(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                              const pci_place *closest, const pc_skin *followed, uint32_t slots,
                              uint32_t *bones, double *weights);

// Optimises and cuts to the influences of the result; fills the losses of the report.
PC_NODISCARD pc_status pci_skin_fit_alternate(pci_skin_fit *fit, pc_skin_report *report);
PC_NODISCARD pc_status pci_skin_fit_adamw(pci_scratch *scratch, pci_skin_fit *fit,
                                          pc_skin_report *report);

// Takes from smaller problems how the weights change that vary slowly. `rounds` (in and out): of
// what is left to do with all candidates; more where there is no smaller problem.
PC_NODISCARD pc_status pci_skin_start_from_coarse(pci_skin_fit *fit, pci_skin_gram *gram,
                                                  uint32_t *rounds);

#endif
