// Shallow dents of the outside that the labels left out.
#ifndef PCI_DENTS_H
#define PCI_DENTS_H

#include "geometry/knn.h"
#include "proxycloth/mesh.h"

// What the labels leave out of the closed mesh is the inside, which ends where the garment ends.
// Where the hem of one layer hangs over another, or folds lie against each other, they may leave
// out a dent of the outside as well: a narrow strip, part of whose border is far from all rims.
// Marks the triangles of such strips in `keep`, #F. False: out of memory.
bool pci_keep_dents(pci_scratch *scratch, const pc_mesh *projected, const pci_knn *rims,
                    double cell_size, uint8_t *keep);

#endif
