// Shallow dents of the outside that the labels left out.
#ifndef PCI_DENTS_H
#define PCI_DENTS_H

#include "geometry/bvh.h"
#include "geometry/knn.h"

// What the labels leave out of the closed mesh is the inside, which ends where the garment ends.
// Where the hem of one layer hangs over another, or folds lie against each other, they may leave
// out a dent of the outside as well: a narrow strip, part of whose border is far from all rims.
// Marks the triangles of such strips in `keep`, #F. The other side of a strap that has no rims, as
// of a closed body, stays out.
// @param tree  that of `projected`, built here if it is needed and NULL, for the caller to destroy
// Returns PC_OK, PC_ERROR_OUT_OF_MEMORY or PC_ERROR_DEPENDENCY.
pc_status pci_keep_dents(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                         const pci_knn *rims, double cell_size, pci_bvh **tree, uint8_t *keep);

#endif
