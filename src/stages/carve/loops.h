// Filling the holes of a layer.
#ifndef PCI_LOOPS_H
#define PCI_LOOPS_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Closes the boundary loops of at most `most_edges` edges that are not longer than `longest`, with
// a fan around their mean or with one triangle. A loop that bounds its part from outside stays: the
// part needs twice the area of a disc of that circumference. `filled` is added to. The mesh must be
// manifold. False: out of memory.
bool pci_fill_loops(pci_scratch *scratch, pc_mesh *mesh, size_t most_edges, double longest,
                    uint64_t *filled);

#endif
