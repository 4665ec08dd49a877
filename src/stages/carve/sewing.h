// Garments that are worn over each other: a shirt over trousers.
#ifndef PCI_SEWING_H
#define PCI_SEWING_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Cuts away what has the back of another component within `reach` before it, and sews the border of
// what is left to the hem above it where the two run along each other all the way. The mesh is
// manifold and its front is the outside; it stays so. `sewn` tells whether it changed.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_sew_parts(pci_scratch *scratch, const char *stage, double reach,
                                     pc_mesh *mesh, bool *sewn);

#endif
