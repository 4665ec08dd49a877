// Weights of one garment on their way from the first guess to the result. For skin*.c.
#ifndef PCI_SKIN_FIT_H
#define PCI_SKIN_FIT_H

#include "core/bvh.h"
#include "proxycloth/skin.h"
#include "stages/skin_internal.h"

enum { PCI_SKIN_CANDIDATES_MAX = 32 };

typedef struct pci_skin_fit {
    pc_context *context;
    const pc_skin_options *options;
    const pc_mesh *surface, *proxy;
    const uint8_t *pinned; // of the proxy, or NULL
    pci_skin_problem problem;
    pci_closest *closest; // #V, points on the proxy
    uint32_t *bones;      // #V by slots
    double *weights;      // #V by slots, rows of any sum
    double spatial_share; // of lambda_c and lambda_a that is used
} pci_skin_fit;

// The closest point of the proxy for every visual vertex.
PC_NODISCARD pc_status pci_skin_closest_points(pc_context *context, const pc_mesh *surface,
                                               const pc_mesh *proxy, pci_closest *closest);

// Candidates and first guess, #V by slots. False: out of memory.
bool pci_skin_find_candidates(pci_scratch *scratch, const pc_mesh *surface, const pc_mesh *proxy,
                              const pci_closest *closest, uint32_t slots, uint32_t *bones,
                              double *weights);

// Optimises and cuts to the influences of the result; fills the losses of the report.
PC_NODISCARD pc_status pci_skin_fit_alternate(pci_scratch *scratch, pci_skin_fit *fit,
                                              pc_skin_report *report);
PC_NODISCARD pc_status pci_skin_fit_adamw(pci_scratch *scratch, pci_skin_fit *fit,
                                          pc_skin_report *report);

// Sorts one row by falling weight, ties to the smaller bone.
void pci_skin_sort_row(uint32_t *bones, double *weights, uint32_t count);

#endif
