// Straps that the labels leave out.
#ifndef PCI_STRAPS_H
#define PCI_STRAPS_H

#include "geometry/bvh.h"

// A strap about as thick as wide is a rod, whose sides are no two sides of a sheet, and a pouch as
// wide as its belt is a solid: nothing asks for either side, and where the ends meet sides that are
// left out, all of it is. Pieces of the closed
// `projected` mesh farther than two voxels from all that is labelled 1, with more of the same on
// the other side of the solid, get that label all around, up to what has it already.
// @param labels  #V of `projected`, changed
// @param tree    receives that of `projected`, where it was needed, for the caller to destroy
// Returns PC_OK, PC_ERROR_OUT_OF_MEMORY or PC_ERROR_DEPENDENCY.
pc_status pci_keep_straps(pci_scratch *scratch, const char *stage, const pc_mesh *projected,
                          double cell_size, uint8_t *labels, pci_bvh **tree);

#endif
