// Flattening folds that a coarse proxy cannot follow.
#ifndef PCI_FOLDS_H
#define PCI_FOLDS_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Smooths a mesh of roughly even edges: waves shorter than about four times `width` go, longer ones
// stay. Minimises |x - x0|^2 + width^4 |Laplacian x|^2 with free borders, which
// draw in by less than half of `width`. False: out of memory, or cancelled; pci_fail_memory tells.
bool pci_flatten_folds(pci_scratch *scratch, double width, pc_mesh *mesh);

#endif
