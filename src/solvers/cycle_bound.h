// A lower bound from negative cycles. A cycle with an odd number of "opposite" edges cannot have
// all its wishes fulfilled; so packing such cycles into the edge costs bounds the cost of every
// labelling. The best fractional packing is the dual of the relaxation with odd-cycle inequalities
// (Barahona and Mahjoub, "On the cut polytope", 1986), which is far stronger than roof duality.
#ifndef PCI_CYCLE_BOUND_H
#define PCI_CYCLE_BOUND_H

#include "solvers/signed_graph.h"

typedef struct pci_cycle_bound {
    int64_t bound;      // no labelling costs less
    int64_t *residuals; // #edges: one that violates the edge's wish costs at least this much more
} pci_cycle_bound;

// Work in visited entries; and, on request, a time when it ends.
typedef struct pci_budget {
    uint64_t total, left;
    double deadline; // pci_clock_seconds(), 0: none
} pci_budget;

static inline double pci_budget_used(const pci_budget *budget) {
    return budget->total == 0 ? 0.0 : 1.0 - (double)budget->left / (double)budget->total;
}

// The linear program is solved approximately by a first-order method; the bound comes from a
// packing in integers and holds whatever that method did: what the program packs is rounded, and
// cycles through the ground, which are a flow, fill the rest. `labels` is improved by rounding.
// Stops when bound and cost meet, when half of the vertices can be contracted (a residual is at
// least the gap), when no cycle is violated any more, or when the budget is used up. `residuals`
// comes from `scratch`. PC_ERROR_OUT_OF_MEMORY, PC_ERROR_CANCELLED.
pc_status pci_find_cycle_bound(pci_scratch *scratch, const char *stage,
                               const pci_signed_graph *graph, pci_budget *budget, uint8_t *labels,
                               pci_cycle_bound *result);

#endif
