// Labels that follow the sides of a piece of cloth.
#ifndef PCI_SIDES_H
#define PCI_SIDES_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// The closed `projected` mesh goes around cloth and what is put onto it: whatever shows the way
// that the nearest cloth does gets label 1, the other side 0, with short borders between them where
// it shows neither. Which side of the cloth that is, most of the labels before tell.
// @param cloth   consistently oriented
// @param labels  #V of `projected`, changed
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_label_sides(pci_scratch *scratch, const char *stage,
                                       const pc_mesh *projected, const pc_mesh *cloth,
                                       double cell_size, uint8_t *labels);

#endif
