// Roof duality: a lower bound and provably optimal labels from one maximum flow on the signed
// double cover (Boros and Hammer, "Pseudo-boolean optimization", 2002).
#ifndef PCI_ROOF_DUALITY_H
#define PCI_ROOF_DUALITY_H

#include "solvers/signed_graph.h"

typedef struct pci_roof {
    int64_t bound;          // no labelling costs less
    uint8_t *labels;        // #vertices: 0, 1 or PCI_NO_LABEL; together extend to an optimum
    uint32_t *components;   // #vertices: part of the vertices without label, PC_INVALID_INDEX else
    size_t component_count; // given the labels, these parts do not interact
} pci_roof;

// The arrays come from `scratch`. False: out of memory or cancelled.
bool pci_roof_duality(pci_scratch *scratch, const pci_signed_graph *graph, pci_roof *roof);

// Packs cycles through the ground into the capacities of the edges, as many as roof duality proves,
// and subtracts what they use. `gain`: the sum of their amounts, rounded down.
bool pci_pack_ground_cycles(pci_scratch *scratch, const pci_signed_graph *graph,
                            int64_t *capacities, int64_t *gain);

#endif
