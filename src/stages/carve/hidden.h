// Parts of a garment that lie on larger ones: linings, pockets, buttons, second sides of a cape.
#ifndef PCI_HIDDEN_H
#define PCI_HIDDEN_H

#include "core/core.h"
#include "proxycloth/mesh.h"

// Leaves out the components of `mesh` that lie within `reach` of larger ones everywhere. Only
// components of at least a twentieth of the area hide others: the triangles of a mesh that is not
// welded do not hide each other. Components of equal area: the first one stays.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_drop_hidden(pci_scratch *scratch, const char *stage, double reach,
                                       pc_mesh *mesh);

#endif
