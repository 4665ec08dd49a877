// Small parts of the labelled layer: crumbs of the labels, or loose parts of the garment.
#ifndef PCI_CRUMBS_H
#define PCI_CRUMBS_H

#include "geometry/bvh.h"

// Removes the components smaller than `fraction` of the largest one's area. A loose part stays: it
// has a vertex farther than `reach` from the larger ones, and most of it lies on a component of the
// visual mesh that the larger ones do not cover. `dropped` is added to.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY.
PC_NODISCARD pc_status pci_drop_crumbs(pci_scratch *scratch, const char *stage,
                                       const pc_mesh *surface, const pci_bvh *visual,
                                       double fraction, double reach, pc_mesh *layer,
                                       uint64_t *dropped);

#endif
