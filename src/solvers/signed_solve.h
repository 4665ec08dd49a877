// Minimum of a signed graph: exact where it can be proven within the work budget.
#ifndef PCI_SIGNED_SOLVE_H
#define PCI_SIGNED_SOLVE_H

#include "solvers/cycle_bound.h"

typedef struct pci_signed_solution {
    uint8_t *labels;      // #vertices, from the caller
    int64_t bound;        // no labelling costs less; the cost of `labels` where it is proven
    int64_t roof_bound;   // of roof duality alone
    size_t open_vertices; // without label after roof duality
    size_t components;    // of those vertices
    size_t unproven;      // components that ended without proof
} pci_signed_solution;

// `budget` limits the search where the exact methods end.
// PC_ERROR_OUT_OF_MEMORY, PC_ERROR_CANCELLED.
pc_status pci_signed_solve(pc_context *context, const char *stage, const pci_signed_graph *graph,
                           pci_budget budget, pci_signed_solution *solution);

#endif
