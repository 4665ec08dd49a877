// Tubes that end at an opening, such as sleeves and legs, laid out in rings: a thin one gets the
// same few clusters around at every place along it, one behind the other.
#ifndef PCI_RINGS_H
#define PCI_RINGS_H

#include "stages/simplify/relax.h"
#include "stages/simplify/sampling.h"

typedef struct pci_rings {
    size_t count;      // clusters
    uint32_t *cluster; // #V of the fine mesh, below count; PC_INVALID_INDEX: in no tube
    uint32_t *aside;   // per cluster, the next one around the tube
    uint32_t *ahead;   // per cluster, the next one along the tube; PC_INVALID_INDEX: none
} pci_rings;

// Finds the tubes that are between three and five clusters around where `vertices` clusters follow
// the sampling's scales, and the clusters of their rings. The cells are nearly squares, or longer
// where a tube needs more clusters around than the scales give it.
// @param turn  turns the rings by so many eighths of a cluster from where they fit best
// False: out of memory or cancelled.
bool pci_find_rings(pci_scratch *scratch, const pci_sampling *sampling, size_t vertices,
                    size_t turn, pci_rings *rings);

// Binds the coarse vertices of the rings (PCI_RINGED) and turns the diagonals between them to the
// shorter ones.
// @param nearby  per fine vertex, the coarse vertex it was merged into
// False: out of memory.
bool pci_lace_rings(pci_scratch *scratch, const pci_rings *rings, const uint32_t *nearby,
                    pci_relaxation *relaxation);

#endif
