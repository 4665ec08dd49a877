// Minimum of a signed graph: exact where it can be proven within the work budget.
#ifndef PCI_SIGNED_SOLVE_H
#define PCI_SIGNED_SOLVE_H

#include "core/signed_graph.h"

typedef struct pci_signed_solution {
    uint8_t *labels; // #vertices, from the caller
    int64_t cost;    // of `labels`
    int64_t bound;   // no labelling costs less
} pci_signed_solution;

// False: out of memory.
bool pci_signed_solve(pc_context *context, const pci_signed_graph *graph, uint32_t effort,
                      pci_signed_solution *solution);

#endif
