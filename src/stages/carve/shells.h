// Cloth that is modelled with its thickness: closed shells of two skins and a rim between them.
#ifndef PCI_SHELLS_H
#define PCI_SHELLS_H

#include "core/core.h"
#include "geometry/topology.h"

// Leaves only the outer skin of every closed component of `mesh` that is a shell no thicker than
// `thickest` as a rule. The mesh is manifold and stays so. `thickness` receives that of the
// thickest shell peeled; 0: there is none, and the mesh stays as it is. `topology`: its edges.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_peel_shells(pci_scratch *scratch, const char *stage, double thickest,
                                       const pci_topology *topology, pc_mesh *mesh,
                                       double *thickness);

#endif
