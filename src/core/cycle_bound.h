// A lower bound from negative cycles. A cycle with an odd number of "opposite" edges cannot have
// all its wishes fulfilled; so packing such cycles into the edge costs bounds the cost of every
// labelling. The best fractional packing is the dual of the relaxation with odd-cycle inequalities
// (Barahona and Mahjoub, "On the cut polytope", 1986), which is far stronger than roof duality.
#ifndef PCI_CYCLE_BOUND_H
#define PCI_CYCLE_BOUND_H

#include "core/signed_graph.h"

typedef struct pci_cycle_bound {
    int64_t bound;      // no labelling costs less
    int64_t *residuals; // #edges: one that violates the edge's wish costs at least this much more
} pci_cycle_bound;

// The linear program is solved approximately by a first-order method; the bound comes from a
// packing in integers and holds whatever that method did. `labels` is improved by rounding. Stops
// when bound and cost meet, when half of the vertices can be contracted (a residual is at least the
// gap), when no cycle is violated any more, or when `work` (entries visited) is used up.
// `residuals` comes from `scratch`. False: out of memory.
bool pci_find_cycle_bound(pci_scratch *scratch, const pci_signed_graph *graph, uint64_t *work,
                          uint8_t *labels, pci_cycle_bound *result);

#endif
